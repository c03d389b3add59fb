"""Episodes of a team."""
