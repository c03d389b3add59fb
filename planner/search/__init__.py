"""The compiled search through all reachable states. Newcomers can skip it."""
