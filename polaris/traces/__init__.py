"""Traces of RTAEval, in and out: read and write them, measure them, export runs as such."""

from reach.numerics.packages import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
