"""Solving many instances, with records that allow a run to be resumed."""
