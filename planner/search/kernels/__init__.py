"""Compiled loops of the search. This folder contains nothing else."""
