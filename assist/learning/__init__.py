"""What recorded actions tell about people."""
