"""A team of several people and one robot: the state that a policy receives, and the policies."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
