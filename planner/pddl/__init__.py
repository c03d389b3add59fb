"""PDDL files: finding, reading, checking against the supported fragment, and validation."""
