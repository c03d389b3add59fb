"""The exact cost-to-go: tables of all states, single states on demand, and their verification."""
