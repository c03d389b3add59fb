"""The search through all reachable states: with numpy for small tasks, compiled for larger ones.

One forward search and one bucket Dijkstra work on a `SearchSpace`, which expands and relaxes blocks of states. Each
space has a `StateIndex`, from a state to its number and back: in sorted arrays (`sorted_space`), by rank, by a
registry, or by a registry of canonical states. Newcomers can skip all compiled spaces. What ranks cannot do (derived
variables, too many bits, too many moves) falls back to the registry.
"""
