"""The exact cost-to-go: tables of all states or orbits, single states on demand, and their verification."""
