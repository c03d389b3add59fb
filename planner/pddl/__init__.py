"""PDDL files: found, read, checked against the supported fragment, and validated."""
