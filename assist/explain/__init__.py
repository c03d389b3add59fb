"""Contrastive explanations: why this step, why this person, and why nothing, from h* and beliefs."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
