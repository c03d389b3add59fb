"""Compiled loops of the search, and nothing else."""
