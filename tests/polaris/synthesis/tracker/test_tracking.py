"""The tracking controller (Proposition 1): gains, refused by name where there are none, and its period."""

import subprocess
import sys

import control
import numpy as np
import pytest

from polaris import Feedback, LinearSystem, ScenarioError, Tracking, load_scenario, synthesize
from polaris.certificate.checker import verify_document
from polaris.runs.certificate import certificate
from polaris.synthesis.tracker.feedback import MOST_NODES, choose_feedback
from polaris.synthesis.tracker.lqr import solve_are
from tests.polaris.tiny import TINY

SADDLE, BOTH = np.diag([1.0, -1.0]), np.ones((2, 1))
CHAIN, PUSH = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])


@pytest.mark.parametrize(
    ("A", "B", "Q", "R"),
    [
        (SADDLE, PUSH, np.eye(2), np.eye(1)),  # not stabilisable
        (CHAIN, PUSH, np.zeros((2, 2)), np.eye(1)),  # Q sees nothing
        (SADDLE, BOTH, np.eye(2), np.zeros((1, 1))),
        (SADDLE, BOTH, np.eye(2), -np.eye(1)),
        (SADDLE, BOTH, np.array([[1.0, 2.0], [0.0, 1.0]]), np.eye(1)),
        (SADDLE * 1e200, BOTH, np.eye(2), np.eye(1)),
        (SADDLE, BOTH, np.eye(2) * 1e300, np.eye(1) * 1e-300),
    ],
)
def test_weights_or_systems_without_a_stabilising_solution_are_refused(A, B, Q, R):
    with np.errstate(all="ignore"), pytest.raises(ScenarioError, match="tracking.Q"):
        solve_are(A, B, Q, R)


def spinning(rate):
    """A plant that turns, a gain that cancels it, and the share of an error that a period of 1/q s leaves."""
    turn = rate * np.array([[0.0, 1.0], [-1.0, 0.0]])
    system, gain = LinearSystem(turn, np.eye(2), np.eye(2), [1.0, 1.0], 0.0), turn + np.eye(2)

    def left(q):
        phi = Feedback(q).flow(system, gain, 1.0).phi
        return np.abs(np.linalg.eigvals(phi)).max()

    return system, gain, left


def test_without_a_period_there_are_four_per_fastest_time_constant():
    system = LinearSystem(-np.eye(1), np.eye(1), np.eye(1), [1.0], 0.0)
    gains = [np.array([[2.0]]), np.array([[4.0]])]  # closed loops at 3/s and 5/s
    assert choose_feedback(system, gains, 1.0, None) == Feedback(20)
    assert choose_feedback(system, gains[:1], 1.0, None) == Feedback(12)
    assert choose_feedback(system, gains, 1.0, 0.5) == Feedback(2)
    assert choose_feedback(system, gains[:1], 1e-3, None) == Feedback(2)
    assert choose_feedback(system, gains, 1e3, None) == Feedback(MOST_NODES)


def test_periods_are_halved_until_the_loop_is_stable_at_its_nodes():
    system, gain, radius = spinning(100.0)
    q = choose_feedback(system, [gain], 1.0, None).nodes_per_cell
    assert radius(4) > 1 and radius(q // 2) >= 1 > radius(q) and q in (8, 16, 32, 64, 128)
    Tracking(system, gain, Feedback(q), 1.0).flow  # noqa: B018


def test_what_no_period_makes_stable_is_refused():
    system, gain, radius = spinning(128 * (2 * np.pi - 0.05))  # at 4, 8, ... 200 nodes it pushes along
    q = choose_feedback(system, [gain], 1.0, None)
    assert q == Feedback(MOST_NODES) and radius(MOST_NODES) > 1
    with pytest.raises(ScenarioError, match="feedback.period_s.*must give a stable loop"):
        Tracking(system, gain, q, 1.0).flow  # noqa: B018


OBSERVED = (
    "navigation.measurement.matrix=[[1,0,0,0],[0,1,0,0]]",
    "navigation.measurement.error=[0.002,0.002]",
)


CHOSEN = [
    (),
    (*OBSERVED, "thrusters.impulse_bit_N_s=0.0005", "thrusters.remainder=carried", "timing.delay_s=0.1"),
    ("timing.jitter_s=0.005", "timing.missed_periods=1"),
]


@pytest.mark.parametrize("more", CHOSEN)
def test_a_period_that_is_chosen_is_told_and_serves_whatever_needs_one(more):
    scenario = load_scenario(TINY, ["tracking.R=[60,60]", *more])
    schedule, h = synthesize(scenario), 1 / 9
    assert scenario.period() == schedule.safety.tracking.flow.h == pytest.approx(h)
    assert f"(commands each {h:g} s)" in scenario.outline()
    premise = f"sampling: commands are renewed on time every {h:g} s from "
    assert any(line.startswith(premise) for line in schedule.assumptions)
    assert schedule.guarantee == "proved" and schedule.share() > 0
    assert verify_document(certificate(schedule, scenario.name)).outcome == "VERIFIED"


def test_the_riccati_equation_is_solved_as_the_control_library_solves_it():
    rng = np.random.default_rng(3)
    for n, m in ((1, 1), (2, 1), (4, 2), (6, 3)):
        A, B = rng.normal(size=(n, n)), rng.normal(size=(n, m))
        Q, R = np.diag(rng.uniform(0.1, 2, n)), np.diag(rng.uniform(0.1, 2, m))
        P, gain = solve_are(A, B, Q, R)
        expected, _, other = control.care(A, B, Q, R, method="scipy")
        assert np.allclose(P, expected, rtol=1e-12) and np.allclose(gain, other, rtol=1e-12)


def test_a_synthesis_loads_what_it_uses():
    """These take from a tenth of a second to more than one to load, and serve other verbs or other errors."""
    code = (
        "import sys; from polaris.scenario.scenario import load_scenario as load; import polaris\n"
        "polaris.synthesize(load(sys.argv[1]))\n"
        "others = {'scipy.signal', 'scipy.stats', 'control', 'flint', 'matplotlib', 'plotly'}\n"
        "print(sorted(others & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code, str(TINY)], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
