"""Exports to other programs: POMDP file formats, pomdp-py objects, Gymnasium and PettingZoo environments."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
