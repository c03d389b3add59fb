"""Several people and robots: what a policy receives, the policies, one step of a team, and simulated episodes."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
