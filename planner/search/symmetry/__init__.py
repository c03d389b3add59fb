"""Symmetries of a task, and one canonical state of each orbit."""
