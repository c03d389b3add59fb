"""Declared data: each field of a setting, a robot or a plan is declared once, with its range and one sentence.

A class is declared with `declared`. From its fields follow the check of values, errors of one sentence, plain data for
records (`plain`), tables of TOML files with the line of a fault (`tables`) and options of the command line (`options`).
"""

from planner.system.lazy_imports import lazy_exports

__getattr__, __dir__, __all__ = lazy_exports(__name__, __file__)
