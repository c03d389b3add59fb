"""The compiled search through all reachable states. Newcomers can skip it.

One forward search and one bucket Dijkstra work on a `SearchSpace`, which expands and relaxes blocks of states. Each
space has a `StateIndex`, from a state to its number and back: by rank, by a registry, or by a registry of canonical
states. What ranks cannot do (derived variables, too many bits, too many moves) falls back to the registry.
"""
