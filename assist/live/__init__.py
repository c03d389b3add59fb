"""The live assistant: one team of real people, action by action, with explanations of its suggestions."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
