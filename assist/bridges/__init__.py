"""Bridges between a live session and the protocols of a line (extras `mqtt`, `opcua`, `ros2`)."""

from planner.system.lazy_imports import lazy_exports

__getattr__, __dir__, __all__ = lazy_exports(__name__, __file__)
