"""Bridges between a live session and the protocols of a line (extras `mqtt`, `opcua`, `ros2`)."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
