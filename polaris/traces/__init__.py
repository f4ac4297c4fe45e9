"""Traces of RTAEval, in and out: read and write them, measure them, export runs as such."""

from reach.numerics.packages import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
