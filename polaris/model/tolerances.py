"""Every tolerance of the package, in one place: what it protects and which way it errs.

A tolerance that guards a proof *tightens* a condition: it is added to the required value, never subtracted.
"""

ROUNDING = 1e-9
"""Relative slack added to every computed support, clearance and norm before it is compared.

Covers round-off of double-precision sums of a few thousand terms (about 1e-13 each) with four
orders of magnitude to spare. Errs towards "unsafe".
"""

REFERENCE = 1e-12
"""Relative round-off of a reference's states from one step to the next, added to the error at the end of
every step: a controller that is unstable alone makes it grow, if nothing else is there to grow."""

SOLVER_FEASIBILITY = 1e-7
"""Feasibility tolerance handed to the MIP solver, in scaled units (rows have coefficients near 1)."""

SOLVER_BOOK_M = 1e-3
"""Length [m] by which planned clearances exceed what the re-check demands, so that solver
tolerances (row feasibility and integrality times the per-row M) cannot turn into a violation."""

SOLVER_BOOK_INPUT = 1e-6  # share of the input limit that the planner leaves unused, for the same reason

GOAL = 1e-6
"""Largest violation of a goal condition, relative to its scale, that still counts as met. The
violation itself is not ignored: the end condition starts from the state really reached."""

TIME = 1e-9  # relative slack when asking whether one duration divides another

FARTHEST = 1e6
"""Positions [m] and velocities [m/s] beyond this are taken for faults of the sensors, as nan is."""
