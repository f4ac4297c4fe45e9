"""Reachable sets of linear systems: zonotopes, tubes sound in continuous time, relaxations.

A library of its own: it needs numpy and scipy only. Names are imported when first used; what is public,
and where it lives, stands in the stub beside this file.
"""

from .numerics.packages import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
