"""Several people and robots: the state that a policy receives, the policies, and one step of a team."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
