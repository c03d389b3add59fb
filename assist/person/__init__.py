"""One person's assistance problem, and its solutions between proven bounds."""
