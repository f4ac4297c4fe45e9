"""Campaigns: any number of runs over scenarios, seeds and grids of values, on any executor."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
