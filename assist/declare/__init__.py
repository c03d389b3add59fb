"""Declared data: each field of a setting, robot or plan is declared once, with its range and one sentence.

A class is declared with `declared`. From its fields follow the check of values, errors of one sentence, plain data for
records (`plain`), tables of TOML files with the line of a fault (`tables`) and options of the command line (`options`).
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
