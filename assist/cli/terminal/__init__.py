"""Signals that end a command, errors in one line, JSON and tables out: what concerns the terminal."""
