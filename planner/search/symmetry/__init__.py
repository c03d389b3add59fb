"""Symmetries of a task, and the canonical state of each orbit."""
