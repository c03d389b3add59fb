"""Models of people: choices, influence and trust, populations, and the belief in a person."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
