"""States of a grounded task, and the transitions between them."""
