"""Bounds on what any team policy can get."""
