"""Estimates of people's parameters, trust rules and goals from recorded actions."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
