"""Terminal input and output: signals, one-line errors, JSON and tables."""
