"""Bounds from sample paths: a robot that knows everybody's sample path, and pays a penalty for it."""
