"""Pictures of tasks, plans and episodes, for any domain; `plots` has figures of results (extra `plots`)."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
