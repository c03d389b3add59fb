"""Studies with simulated people (extra `study`), with real people (`userstudy`), and their `reports`."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
