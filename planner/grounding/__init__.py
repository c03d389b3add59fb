"""The grounded task: what Fast Downward's translator makes of PDDL files."""
