"""Campaigns: any number of runs over scenarios, seeds and grids of values, on any executor."""

from reach.numerics.packages import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
