"""Run time assurance of spacecraft by switching schedules that are proven before the flight.

>>> import polaris
>>> scenario = polaris.load_scenario("static")
>>> safety = polaris.get_safety(scenario)                 # Algorithm 1
>>> schedule = polaris.synthesize(scenario, safety)       # Algorithm 2
>>> runs = polaris.simulate(schedule, n=1000, seed=0)
>>> runs.metrics().summary()["min_distance_m"] > 0
True

Names are imported when they are first used, so that ``import polaris`` costs next to nothing; what is public,
and where it lives, stands in the stub beside this file.
"""

from contextlib import suppress

# The checker, `python -m polaris.certificate`, runs where there is nothing but Python and python-flint.
with suppress(ModuleNotFoundError):
    from reach.numerics.packages import attach

    __getattr__, __dir__, __all__ = attach(__name__, __file__)
