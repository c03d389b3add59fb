"""States as integers: invariants and mutexes of a task, and the ranking made of them."""
