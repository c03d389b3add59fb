"""Declared data: each field has its range and one sentence; texts in each language; reasons of refusals.

A class is declared with `declared`. From its fields follow the check of values, errors of one sentence, plain data for
records (`plain`), tables of TOML files with the line of a fault (`tables`) and options of the command line (`options`).
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
