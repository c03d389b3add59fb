"""Studies with simulated people: their description, execution and results (extra `study`)."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
