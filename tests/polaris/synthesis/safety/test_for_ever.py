"""Bounds on S's error and commands for ever, source by source, against what a flight needs at least."""

import numpy as np
import pytest

from polaris.scenario.scenario import load_scenario
from polaris.synthesis.tracker.tracking import Tracking

ESTIMATE = ("navigation.position_error_m=0.05", "navigation.velocity_error_m_s=0.002")
CAMERA = ("navigation.measurement.position_error_m=0.1",)
DELAY = ("timing.delay_s=2.0",)
THRUSTERS = ("thrusters.magnitude_error=0.05", "thrusters.misalignment_deg=2.0", "thrusters.mass_error=0.03")
BIT = ("thrusters.impulse_bit_N_s=0.005", 'thrusters.remainder="carried"')
MOST = {  # position [m] and command [mN] for ever, as sections 2 and 3 of the theory bound them
    "disturbance": ((), 0.104, 0.45),
    "estimate, delay": ((*ESTIMATE, *DELAY), 0.37, 2.2),
    "thrusters": ((*ESTIMATE, *DELAY, *THRUSTERS), 0.60, 3.0),
    "carried bit": ((*ESTIMATE, *DELAY, *THRUSTERS, *BIT), 0.65, 3.6),
    "camera": ((*CAMERA, *DELAY), 0.54, 2.1),
    "camera, all": ((*CAMERA, *DELAY, *THRUSTERS, *BIT), 1.0, 7.6),
}


def tracking(given):
    problem = load_scenario("static").with_assignments(["feedback.period_s=2.0", *given]).problem()
    return Tracking(problem.system, problem.gain, problem.feedback, problem.delta, 0.5)


@pytest.mark.parametrize("name", MOST)
def test_what_s_needs_for_ever_is_little_more_than_its_fixed_point(name):
    """The fixed point of commands and errors bounds a flight that has always been under S alone."""
    given, bound, command = MOST[name]
    tracker = tracking(given)
    C, limits = tracker.system.position, tracker.tightening
    needed = tracker.settled_tightening(C).max()
    assert needed <= bound
    alone = limits.settled_bound()
    least = limits.from_rest(tracker.whole(C), alone)[-1].max()
    assert least <= needed * (1 + 1e-9) and needed <= 1.06 * least
    last = alone if tracker.feedback_bound is None else tracker.feedback_bound[-1]
    assert (
        np.all(alone <= last * (1 + 1e-9)) and np.all(last <= 1.06 * alone) and last.max() <= command * 1e-3
    )


def test_a_bound_of_an_axis_is_reached_by_the_signs_that_count():
    """Without errors that grow with commands the bound at a node is a sum that an adversary attains."""
    tracker = tracking((*ESTIMATE, *DELAY))
    limits, row = tracker.tightening, tracker.whole(tracker.system.position[:1])
    F, z = limits.closed.F, np.zeros(limits.closed.loop.N)
    channel = next(c for c in limits.closed.loop.channels if c.name == "estimate")
    adds = limits.closed.sampled(channel)
    rows = [row[0] @ np.linalg.matrix_power(F, age) for age in range(200)]
    for age in reversed(range(200)):
        z = F @ z + adds @ (channel.size * np.sign(rows[age] @ adds))
    quiet = sum(float(np.abs(r @ adds) @ channel.size) for r in rows)
    assert row[0] @ z == pytest.approx(quiet, rel=1e-9)
    assert limits.response(channel, row, tracker.system.position[:1]).at_nodes(
        np.tile(channel.size, (200, 1))
    )[200] == pytest.approx(quiet, rel=1e-6)
