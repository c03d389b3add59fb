"""States as integers: the invariants and mutexes of a task, and the ranking that is built from them."""
