"""The compiled search through all reachable states. It can be skipped at a first reading."""
