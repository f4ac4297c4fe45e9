"""Scenes shared by the tests: synthesised once per run."""

from functools import cache

import numpy as np
import pytest

from polaris.model.hill import clohessy_wiltshire
from polaris.model.scene.obstacles import BoxObstacle
from polaris.planning.goals import EllipticalNMT
from polaris.planning.reference import Reference
from polaris.synthesis.controllers.controllers import AffineController, AnyThrust
from polaris.synthesis.safety.get_safety import get_safety
from polaris.synthesis.safety.problem import Problem
from polaris.synthesis.tracker.lqr import lqr_gain
from reach.sets.zonotope import Zonotope
from tests.kept import kept, scheduled


def synthesised(name, *overrides):
    """(scenario, schedule) of a bundled scenario, with overrides."""
    return scheduled(name, *overrides)


@cache
def small_problem(period=None, w_max=1e-5, recoverable="polytope"):
    """A short transfer past one box: the smallest scene that has everything."""
    system = clohessy_wiltshire(0.0012, 10.0, 0.3, w_max)
    weights = {"Q": [0.04] * 3 + [25.0] * 3, "R": [400.0] * 3}
    start = Zonotope.box([0, 400.0, 0, 0.24, 0, 0], [3, 3, 3, 0.01, 0.01, 0.01])
    box = BoxObstacle("debris", [125.0, 230.0, 0.0], [25.0] * 3)
    stiff = lqr_gain(system, [0.25] * 3 + [100.0] * 3, [400.0] * 3)
    goal, extra = EllipticalNMT(0.0012, 40.0, 80.0), {"period": period, "recoverable": recoverable, **weights}
    return Problem(system, start, (box,), 60, 30.0, goal=goal, extra_margin=20.0, gains=(stiff,), **extra)


@cache
def _safety(period, w_max, recoverable):
    name = f"small-{period}-{w_max}-{recoverable}"
    return kept(name, lambda: get_safety(small_problem(period, w_max, recoverable)))


def small_safety(period=None, w_max=1e-5, recoverable="polytope"):
    """Algorithm 1 on `small_problem`; the same arguments, however given, are the same object."""
    return _safety(period, w_max, recoverable)


@cache
def small_controllers(period=None, w_max=1e-5):
    """Named experimental controllers on `small_problem`."""
    safety = small_safety(period, w_max)
    system, stiff = safety.problem.system, safety.problem.gains[0]
    coasting = Reference.propagate(system, 30.0, safety.reference.chi[0], np.zeros((60, 3)))
    distant = Reference(system, 30.0, np.tile([0, 430.0, 0, 0, 0, 0], (61, 1)), np.zeros((60, 3)))

    def affine(name, reference, clips):
        return AffineController(name, system, stiff, safety.reference, reference, safety.tracking, clips)

    return {
        "shared": affine("shared", safety.reference, False),
        "coasting": affine("coasting", coasting, False),
        "clipped": affine("clipped", distant, True),
        "any": AnyThrust("any", system, safety.reference, safety.tracking),
    }


@pytest.fixture(scope="module", autouse=True)
def few_slices():
    """Write run folders with few slices of recoverable sets: all of them cost more than a small flight."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("polaris.runs.build_plot_data.SLICES", 1)
        yield


@pytest.fixture(params=[None, 2.0], ids=["chosen", "given"])
def period(request):
    """Control period: chosen, or given."""
    return request.param
