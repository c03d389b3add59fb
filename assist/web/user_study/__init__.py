"""A user study over HTTP."""
