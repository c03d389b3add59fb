"""Reports of studies: what is compared, wording, tables and figures. The tests and intervals are in `studies`."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
