"""PDDL files: finding, reading, compiling numbers and time away, and validation."""
