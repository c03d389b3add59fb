"""The grounded task, which Fast Downward's translator derives from PDDL files."""
