"""Campaigns: any number of runs over scenarios, seeds and grids of values, on any executor."""

from reach.numerics.packages import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
