"""Traces of RTAEval, in and out: read and write them, measure them, export runs as such."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
