"""Reachable tubes (Theorem 10) against simulation: at the nodes, and between them (Proposition 9)."""

import numpy as np
import pytest
from scipy.linalg import expm

from polaris.model.system import LinearSystem
from polaris.planning.reference import Reference
from polaris.synthesis.controllers.controllers import AffineController, AnyThrust
from polaris.synthesis.safety.carried_rows import error_tube
from polaris.synthesis.tracker.feedback import Feedback
from polaris.synthesis.tracker.tracking import Tracking
from reach.numerics.linear import discretize
from reach.sets.zonotope import Zonotope
from tests.polaris.conftest import small_controllers, small_safety

START = Zonotope.box(np.zeros(6), [2, 2, 2, 0.01, 0.01, 0.01])


def fly(safety, law, k, e0, rng):
    """Errors in one step of a law from an error, independently of the tubes; eight parts of every period."""
    system, q = safety.problem.system, safety.tracking.feedback.nodes_per_cell
    parts = 8
    dt = safety.tracking.flow.h / parts
    Ad, Bd = discretize(system.A, system.B, dt)
    _, Dd = discretize(system.A, system.D, dt)
    errors = [e0]
    xi, own = (
        safety.reference.chi[k],
        (law.own if isinstance(law, AffineController) else safety.reference).chi[k],
    )
    x = xi + e0
    mu, mu_own = (
        safety.reference.nu[k],
        (law.own if isinstance(law, AffineController) else safety.reference).nu[k],
    )
    w = rng.normal(size=3)
    push = rng.choice([-1.0, 1.0], size=3) * system.u_max
    for step in range(q * parts):
        if rng.random() < 0.3:
            w = rng.normal(size=3)
        if rng.random() < 0.1:
            push = rng.choice([-1.0, 1.0], size=3) * system.u_max
        if not isinstance(law, AffineController):
            held = push
        elif step % parts == 0:
            held = np.clip(mu_own + law.gain @ (own - x), -system.u_max, system.u_max)
        x = Ad @ x + Bd @ held + Dd @ (w / np.linalg.norm(w) * system.w_max)
        xi, own = Ad @ xi + Bd @ mu, Ad @ own + Bd @ mu_own
        errors.append(x - xi)
    return np.array(errors)


@pytest.mark.parametrize("name", ["shared", "coasting", "clipped", "any"])
def test_tube_holds_the_flight_at_and_between_nodes(name, period):
    safety, law = small_safety(period), small_controllers(period)[name]
    rng = np.random.default_rng(1)
    D = np.vstack([np.eye(6), -np.eye(6), rng.normal(size=(12, 6)) / [5, 5, 5, 0.1, 0.1, 0.1]])
    for k in (0, 7):
        flight = law.propagate(START, k)
        if flight.refused:
            assert k > 0, "every law can fly the first step"
            continue
        nodes = flight.nodes.support(D)
        booked = flight.intersample @ np.abs(D).T
        for _ in range(4):
            e0 = START.sample(rng, 1)[0] if rng.random() < 0.5 else START.support_vector(rng.normal(size=6))
            errors = fly(safety, law, k, e0, rng)
            reached = errors @ D.T
            scale = 1e-6 * (1 + np.abs(nodes).max(axis=0))
            for i in range(len(flight.intersample)):
                inside = reached[8 * i : 8 * i + 9]
                limit = np.maximum(nodes[i], nodes[i + 1]) + booked[i]
                assert np.all(inside <= limit + scale)
            assert np.all(reached[-1] <= flight.end.support(D) + scale)


def test_clipped_tube_differs_from_the_affine_one_only_where_it_clips():
    law = small_controllers(None)["clipped"]
    calm = small_controllers(None)["shared"]
    assert law.propagate(START, 0).refused == ""
    assert (
        AffineController("hard", law.system, law.gain, law.reference, law.own, law.tracking, clips=False)
        .propagate(START, 0)
        .refused.startswith("its command may exceed")
    )
    soft = AffineController(
        "soft", law.system, law.gain, law.reference, law.reference, law.tracking, clips=True
    )
    assert np.array_equal(soft.propagate(START, 0).nodes.G, calm.propagate(START, 0).nodes.G)


@pytest.mark.parametrize("kind", ["affine", "any"])
def test_a_disturbance_that_fades_within_a_period_exceeds_the_chord_of_the_nodes(kind):
    """From rest, in closed form, along a state that no input reaches: the bow must make up for it."""
    system = LinearSystem([[0.0, 0.0], [0.0, -0.5]], [[1.0], [0.0]], np.eye(2), [1.0], 0.1)
    tracking = Tracking(system, np.array([[1.0, 0.0]]), Feedback(2), 1.0)
    still = Reference.propagate(system, 1.0, np.zeros(2), np.zeros((1, 1)))
    law = AnyThrust("any", system, still, tracking)
    if kind == "affine":
        law = AffineController("affine", system, tracking.gain, still, still, tracking)
    flight, row = law.propagate(Zonotope.point(np.zeros(2)), 0), np.array([[0.0, 1.0]])
    nodes, intersample, excess = flight.nodes.support(row)[:, 0], flight.intersample @ row[0], []
    for i in range(len(intersample)):
        for part in np.linspace(0, 1, 41):
            worst = 0.1 / 0.5 * (1 - np.exp(-0.5 * (i + part) * tracking.flow.h))
            excess.append(worst - (1 - part) * nodes[i] - part * nodes[i + 1])
            assert excess[-1] <= intersample[i] * (1 + 1e-9)
    assert max(excess) > 1e-6, "the chord alone does not hold it"


def test_a_law_that_pulls_away_from_the_safe_reference_leaves_the_chord_of_its_nodes():
    """Undisturbed on a reference of its own, the error is the parabola between the two."""
    A, B = [[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]]
    system = LinearSystem(A, B, B, [5.0], 0.0)
    tracking = Tracking(system, np.array([[1.0, 1.5]]), Feedback(2), 1.0)
    safe, own = (Reference.propagate(system, 1.0, np.zeros(2), np.array([[u]])) for u in (-1.0, 1.0))
    law = AffineController("pulls", system, tracking.gain, safe, own, tracking)
    flight, h = law.propagate(Zonotope.point(np.zeros(2)), 0), tracking.flow.h
    for i in range(2):
        chord = flight.nodes.c[i : i + 2, 0].mean()
        assert abs((i + 0.5) ** 2 * h**2 - chord) <= flight.intersample[i, 0] + 1e-15


def test_error_tube_of_s_is_reached_to_a_few_per_cent(period):
    """The closed-form worst case: initial vertex and disturbance against the tight tube."""
    safety = small_safety(period)
    system, tracking = safety.problem.system, safety.tracking
    rows = np.vstack([np.eye(6)[:3], tracking.gain])
    tube = error_tube(tracking, safety.start, rows)
    h, q = tracking.flow.h, 8
    for lag in (1, 5, 20):
        carried = rows @ tracking.transitions[lag]
        reached = np.abs(carried @ safety.start.G).sum(axis=1)
        A_x = tracking.flow.A_x
        for past in range(lag):
            kernel = [
                rows @ tracking.transitions[past] @ expm(A_x * (j + 0.5) * h / q) @ system.D for j in range(q)
            ]
            reached = reached + np.linalg.norm(kernel, axis=-1).sum(axis=0) * h / q * system.w_max
        assert np.all(reached <= tube.tightening[lag] * (1 + 1e-9))
        assert np.all(tube.tightening[lag] <= 1.09 * reached), "within 9 % of what the worst case reaches"
