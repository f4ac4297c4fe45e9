"""Reachable tubes (Theorem 10) against simulation and exact sets: at the nodes, and between them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

import reach
from polaris import AffineController, AnyThrust, Feedback, LinearSystem, Reference, Tracking
from polaris.synthesis.safety.carried_rows import error_tube
from polaris.synthesis.tracker.intersample import at_nodes
from reach import Ellipsoid, Zonotope, discretize, powers, support_tube
from tests.kept import CHOSEN, printed
from tests.polaris.conftest import small_controllers, small_safety

START = Zonotope.box(np.zeros(6), [2, 2, 2, 0.01, 0.01, 0.01])


def fly(safety, law, k, e0, rng, parts=8):
    """Errors in one step of a law from an error, independently of the tubes; eight parts of every period."""
    system, q, reference = safety.problem.system, safety.tracking.feedback.nodes_per_cell, safety.reference
    linear = isinstance(law, AffineController)
    reference = law.own if linear else reference
    dt = safety.tracking.flow.h / parts
    (Ad, Bd), Dd = discretize(system.A, system.B, dt), discretize(system.A, system.D, dt)[1]
    xi, at, errors = safety.reference.chi[k], reference.chi[k], [e0]
    x, w, push = xi + e0, rng.normal(size=3), rng.choice([-1.0, 1.0], size=3) * system.u_max
    for step in range(q * parts):
        w = rng.normal(size=3) if rng.random() < 0.3 else w
        push = rng.choice([-1.0, 1.0], size=3) * system.u_max if rng.random() < 0.1 else push
        if not linear:
            command = push
        elif step % parts == 0:
            command = np.clip(reference.nu[k] + law.gain @ (at - x), -system.u_max, system.u_max)
        x = Ad @ x + Bd @ command + Dd @ (w / np.linalg.norm(w) * system.w_max)
        xi, at = Ad @ xi + Bd @ safety.reference.nu[k], Ad @ at + Bd @ reference.nu[k]
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
        intersample = flight.intersample @ np.abs(D).T
        for _ in range(4):
            e0 = START.sample(rng, 1)[0] if rng.random() < 0.5 else START.support_vector(rng.normal(size=6))
            errors = fly(safety, law, k, e0, rng)
            reached = errors @ D.T
            scale = 1e-6 * (1 + np.abs(nodes).max(axis=0))
            for i in range(len(flight.intersample)):
                inside = reached[8 * i : 8 * i + 9]
                limit = np.maximum(nodes[i], nodes[i + 1]) + intersample[i]
                assert np.all(inside <= limit + scale)
            assert np.all(reached[-1] <= flight.end.support(D) + scale)


def test_clipped_tube_differs_from_the_affine_one_only_where_it_clips():
    law, calm = (small_controllers(None)[name] for name in ("clipped", "shared"))
    assert law.propagate(START, 0).refused == ""
    hard = replace(law, clips=False).propagate(START, 0)
    assert hard.refused.startswith("its command may exceed")
    soft = replace(law, own=law.reference, clips=True).propagate(START, 0)
    assert np.array_equal(soft.nodes.G, calm.propagate(START, 0).nodes.G)


@pytest.mark.parametrize("kind", ["affine", "any"])
def test_a_disturbance_that_fades_within_a_period_exceeds_the_chord_of_the_nodes(kind):
    system = LinearSystem([[0.0, 0.0], [0.0, -0.5]], [[1.0], [0.0]], np.eye(2), [1.0], 0.1)
    tracking = Tracking(system, np.array([[1.0, 0.0]]), Feedback(2), 1.0)
    reference = Reference.propagate(system, 1.0, np.zeros(2), np.zeros((1, 1)))
    law = AnyThrust("any", system, reference, tracking)
    if kind == "affine":
        law = AffineController("affine", system, tracking.gain, reference, reference, tracking)
    flight, row = law.propagate(Zonotope.point(np.zeros(2)), 0), np.array([[0.0, 1.0]])
    nodes, intersample, excess = flight.nodes.support(row)[:, 0], flight.intersample @ row[0], []
    for i in range(len(intersample)):
        for part in np.linspace(0, 1, 41):
            worst = 0.1 / 0.5 * (1 - np.exp(-0.5 * (i + part) * tracking.flow.h))
            excess.append(worst - (1 - part) * nodes[i] - part * nodes[i + 1])
            assert excess[-1] <= intersample[i] * (1 + 1e-9)
    assert max(excess) > 1e-6, "the chord alone does not hold it"


def test_error_tube_of_s_is_reached_to_a_few_per_cent(period):
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


WIDER = 1.05
"""Most by which the width of a stored set along an axis may exceed what is attained there."""


def reached(law, start, rows):
    """Supports attained about the law's reference, at the nodes (q+1, r) and within the periods (q, *, r)."""
    flow, q, system = law.flow, law.feedback.nodes_per_cell, law.system
    ball = Ellipsoid.ball(np.zeros(system.D.shape[1]), system.w_max)
    # From one renewal of the input to the next: each period's share along the row carried to its end.
    carried = rows @ powers(flow.phi, q)
    flat, rest = carried[:-1].reshape(-1, system.n), Zonotope.point(np.zeros(system.n))
    tube = support_tube(reach.LinearSystem(flow.A_x, system.D, ball), rest, flow.h, flat, step=flow.h / 16)
    forced = np.cumsum(tube.attained[-1].reshape(q, -1), axis=0)
    first = np.array([start.support(images) for images in carried])
    nodes = first + np.vstack([np.zeros((1, len(rows))), forced])
    return nodes, nodes[:-1, None]


@pytest.mark.parametrize(
    ("name", "more"),
    [
        ("static", CHOSEN),
        ("dynamic", CHOSEN),
        *(pytest.param(n, "", marks=pytest.mark.slow) for n in ("keep_out", "hold_point", "robot")),
    ],
)
def test_every_stored_set_contains_the_exact_one_and_is_hardly_larger(name, more):
    _, schedule = printed(name, *filter(None, [more]))
    rng, wider = np.random.default_rng(0), []
    for k, step in enumerate(schedule.steps):
        law, stored = schedule.controllers[step.mode], step.tube
        if not isinstance(law, AffineController) or stored.slopes is not None:
            continue  # where the input is any, or a command may be clipped, there is no exact set to compare
        n, zeta = law.system.n, law.offset[k]
        size = stored.nodes.half_widths.max(axis=0)
        rows = np.vstack([np.eye(n), -np.eye(n), rng.normal(size=(24, n)) / np.where(size > 0, size, 1.0)])
        nodes, inside = reached(law, stored.nodes[0] - zeta[0], rows)
        shift = zeta @ rows.T
        holds = stored.nodes.support(rows) - shift
        grain = 1e-9 * (np.abs(nodes).max(axis=0) + np.abs(shift).max(axis=0))
        assert np.all(holds >= nodes - grain), f"step {k}, at the nodes"
        assert np.all(stored.end.support(rows) - shift[-1] >= nodes[-1] - grain), f"step {k}, at its end"
        between = np.maximum(holds[1:], holds[:-1]) + stored.intersample @ np.abs(rows).T
        assert np.all(inside <= between[:, None] + grain), f"step {k}, between the nodes"
        widths = [bounds[1:, :n] + bounds[1:, n : 2 * n] for bounds in (holds, nodes)]
        wider.append((widths[0] / widths[1]).max())
    assert len(wider) > len(schedule.steps) / 3
    assert max(wider) <= WIDER, f"up to {max(wider):.4f} times as wide"


def test_a_bow_at_a_node_is_that_of_the_larger_of_its_sides():
    parts = np.array([[[1.0, 5.0], [3.0, 2.0], [2.0, 4.0]]])
    assert at_nodes(parts).tolist() == [[[1.0, 5.0], [3.0, 5.0], [3.0, 4.0], [2.0, 4.0]]]
