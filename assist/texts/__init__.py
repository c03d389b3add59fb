"""Texts that people read, in each language: pages, questionnaires, refusals, and explanations."""

from planner.system.lazy_imports import lazy_exports

__getattr__, __dir__, __all__ = lazy_exports(__name__, __file__)
