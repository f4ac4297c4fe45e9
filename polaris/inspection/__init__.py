"""The inspection problem: barrier constraints, filters, simplex, fuel limit, Monte Carlo.

After Dunlap, van Wijk, Hobbs: Run Time Assurance for Autonomous Spacecraft Inspection (2023), with the
corrections that ``docs/inspection-theory.md`` lists.
"""

from reach.numerics.packages import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
