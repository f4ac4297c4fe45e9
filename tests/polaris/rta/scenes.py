"""Scenes for the tests of run-time methods, each made once."""

import shutil
from functools import cache

import numpy as np

from polaris.model.scene.obstacles import BoxObstacle
from polaris.model.system import LinearSystem
from polaris.planning.goals import Box
from polaris.planning.reference import Reference
from polaris.rta.decision_grid import DecisionGrid
from polaris.rta.methods import METHODS
from polaris.simulation.on_board import COMPILERS
from polaris.synthesis.controllers.controllers import AffineController, AnyThrust
from polaris.synthesis.safety.get_safety import get_safety
from polaris.synthesis.safety.problem import Problem
from polaris.synthesis.schedule.synthesize import synthesize
from polaris.synthesis.tracker.lqr import lqr_gain
from reach.sets.zonotope import Zonotope
from tests.kept import printed

COMPILED = ("code",) if any(map(shutil.which, COMPILERS)) else ()
"""Methods that need a C compiler, where there is one."""

MADE = {key: one for key, one in METHODS.items() if key in COMPILED or "code" not in key}
"""Methods that can be made here."""


def robot():
    """The bundled scenario of a robot in the plane: sampled feedback, an obstacle at rest, one in motion.

    Scheduled step by step, which gives U as many steps as the search does in a thirtieth of its time.
    """
    return printed("robot", "schedule.strategy=greedy")[1]


@cache
def corridor(period=None, unknown=False):
    """A point mass in the plane that passes a box; U heads straight through it, or may do anything."""
    zero, eye = np.zeros((2, 2)), np.eye(2)
    A = np.block([[zero, eye], [zero, zero]])
    B = np.vstack([zero, eye])
    system = LinearSystem(A, B, B, [0.4, 0.4], 0.01)
    goal = Box([8.0, 0.0, 0.0, 0.0], [0.5, 0.5, 0.1, 0.1])
    Q, R = [1.0, 1.0, 1.0, 1.0], [20.0, 20.0]
    start = Zonotope.box([0.0, 0.0, 0.0, 0.0], [0.1, 0.1, 0.02, 0.02])
    box = BoxObstacle("crate", [4.0, -0.2], [0.8, 0.8])
    problem = Problem(
        system, start, (box,), 40, 0.5, Q, R, goal, period=period, extra_margin=0.3, thrust_reserve=0.3
    )
    safety = get_safety(problem)
    if unknown:
        laws = [AnyThrust("anything", system, safety.reference, safety.tracking)]
    else:
        t = np.linspace(0.0, 1.0, 41)[:, None]
        chi = np.hstack([8 * t, 0 * t, np.full_like(t, 0.4), 0 * t])  # 8 m in 20 s, straight through the box
        u_path = Reference(system, 0.5, chi, np.zeros((40, 2)))
        gain = lqr_gain(system, Q, [5.0, 5.0])
        laws = [AffineController("straight", system, gain, safety.reference, u_path, safety.tracking, True)]
    return synthesize(safety, experimental=laws)


@cache
def scene(name="corridor", period=None, latency=0.0, half=0.0, feedback=None, unknown=False):
    """A scene on which methods fly."""
    schedule = robot() if name == "robot" else corridor(feedback, unknown)
    return DecisionGrid.from_schedule(schedule, period, latency, half)
