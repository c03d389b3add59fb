"""States of a grounded task and their transitions."""
