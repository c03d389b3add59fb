"""Bounds by information relaxation: a robot that knows all sample paths in advance and pays a penalty for it."""
