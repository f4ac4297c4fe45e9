"""Printed margins: never more than the share of the room that is really left, nor much less."""

from dataclasses import replace

import numpy as np
import pytest

from polaris import AffineController, PolarisError, get_safety, load_scenario
from polaris.simulation.disturbances import adjoint_worst_case
from polaris.simulation.integration import Integrator
from polaris.synthesis.safety import continuation
from polaris.synthesis.safety.continuation import Continuation
from polaris.synthesis.safety.get_safety import get_recover
from polaris.synthesis.safety.recoverable import directed, quantity, slack_share
from tests.polaris.conftest import small_safety
from tests.polaris.random_scenarios import synthesised
from tests.polaris.tiny import TINY
from tests.sizes import fewer

STEPS, NODES = 3, 16
"""Steps under U that are looked at in every scene, and nodes after each, the nearest ones all.

Those where the printed margin says that the limit bites come on top.
"""


def worst_share(schedule, k, substeps):
    """Least share of the room left on any limit where S takes over at the start or the end of step k."""
    safety = schedule.safety
    clearance, system, q = safety.clearance, safety.problem.system, safety.clearance.q
    rows, least = np.vstack([clearance.obstacle_rows[0], safety.tracking.gain, -safety.tracking.gain]), np.inf
    path = safety.reference.fine(q)[:, :-1].reshape(-1, system.n)
    for last in (k, k + 1):
        modes = np.append(schedule.modes[:last], np.zeros(clearance.cells - last, dtype=int))
        flight = Integrator(schedule, modes, substeps)
        lags = np.unique(np.geomspace(1, clearance.cells * q, NODES).astype(int)) - 1
        bites = int(schedule.steps[k].margin.time / safety.tracking.flow.h + 0.5) + np.arange(q + 1)
        nodes = np.unique(np.concatenate([last * q + lags, bites]))
        nodes = nodes[(nodes >= max(last * q, 1)) & (nodes < clearance.cells * q)]
        if not len(nodes):
            continue
        which, node = (part.ravel() for part in np.meshgrid(np.arange(len(rows)), nodes, indexing="ij"))
        w, free, adjoint = adjoint_worst_case(flight, rows[which], node * substeps)
        flight.free = free
        states = flight.run(safety.problem.initial_set.support_vector(adjoint), w).states
        errors = states[:, nodes] - path[nodes]
        needs = np.einsum("rn,pjn->jrp", rows, errors).max(axis=-1)  # of any run at any node
        for need, at in zip(needs, nodes, strict=True):
            least = min(least, float(np.min(1 - need / rooms(safety, at))))
    return least


def rooms(safety, node):
    """Room of every row at a node, as far as the cell to its right has such a limit."""
    clearance, system, q = safety.clearance, safety.problem.system, safety.clearance.q
    cell, place = divmod(int(node), q)
    normals, index = clearance.obstacle_rows
    least = np.full(len(normals), np.inf)
    x = safety.reference.fine(q)[cell, place]
    for o, unsafe in enumerate(clearance.unsafe):
        facet = clearance.facets[cell, o]
        room = unsafe.normals[facet] @ system.position @ x - unsafe.fine(q)[cell, place, facet]
        least[index[cell, o]] = min(least[index[cell, o]], room)
    u = safety.reference.nu[cell]
    return np.concatenate([least, system.u_max + u, system.u_max - u])


def looked_at(schedule):
    """Some steps under U."""
    steps = np.flatnonzero(schedule.modes > 0)
    return steps[np.unique(np.linspace(0, len(steps) - 1, STEPS).astype(int))] if len(steps) else steps


def linear(schedule, k):
    """Return True if nothing can have clipped up to a step: the worst case flown is the worst there is."""
    steps = schedule.steps[: k + 1]
    laws = [schedule.controllers[step.mode] for step in steps]
    return all(isinstance(law, AffineController) for law in laws) and not any(
        step.tube.slopes is not None for step in steps
    )


def examined(seeds, folder):
    """(kind, printed, flown, exact) of steps of random scenes."""
    for seed in seeds:
        try:
            _, schedule = synthesised(seed, folder)
        except PolarisError:
            continue
        if schedule.guarantee != "proved":
            continue
        for k in looked_at(schedule):
            share = worst_share(schedule, k, 2)
            yield schedule.safety.recoverable.kind, schedule.margins[k], share, linear(schedule, k)


def judge(found):
    """No margin above what is left; those of polytopes, where the worst case is known, not far below."""
    over = [(printed, share) for _, printed, share, _ in found if not printed <= share + 1e-12]
    assert not over
    short = [share - printed for kind, printed, share, exact in found if exact and kind == "polytope"]
    assert np.median(short) < 0.1 and np.quantile(short, 0.9) < 0.5


def test_margins_of_random_scenes(tmp_path):
    cases = list(examined((2, 10, 33, 43), tmp_path))
    assert len(cases) >= 10 and len({kind for kind, *_ in cases}) == 2
    judge(cases)


@pytest.mark.slow
def test_margins_of_many_random_scenes(tmp_path):
    seeds = range(fewer(100, 50), fewer(200, 65))
    cases = list(examined(seeds, tmp_path))
    assert len(cases) > fewer(150, len(seeds)) and len({kind for kind, *_ in cases}) == 2
    judge(cases)


@pytest.mark.parametrize("kind", ["polytope", "ball"])
def test_a_jump_of_the_reference_counts_as_a_need_and_not_as_less_room(kind, tmp_path):
    safety = synthesised(152, tmp_path)[1].safety
    clearance, tracking = safety.clearance, safety.tracking
    rows = np.vstack([clearance.obstacle_rows[0], tracking.gain, -tracking.gain])
    first, nothing = clearance.planned * clearance.q, 0 * safety.start
    for size in (1e-9, 1e-6, 1e-4):
        jump = size * np.abs(safety.reference.chi[clearance.planned])
        jumped = get_recover(kind, replace(clearance, jump=jump), safety.bounds)
        for error in (jump, -jump, jump * np.array([1, -1, 1, -1, 1, -1])):  # what may happen at T
            needs = rows @ (tracking.transitions @ error).T
            shares = [1 - need / rooms(safety, first + lag) for lag, need in enumerate(needs.T)]
            assert jumped.margin_at(clearance.planned, nothing).value <= np.min(shares)
            assert jumped.margin_at(clearance.planned, nothing).value > 1 - 1e4 * size


def test_no_limit_is_left_out_however_late(period):
    safety = small_safety(period)
    clearance, settling = safety.clearance, safety.tracking.settling
    assert safety.recoverable.margin_at(0, safety.start).inside
    last = clearance.cells * clearance.q - 1
    assert settling + 7 < last
    for node in {*range(clearance.q + 1), *range(settling - 3, settling + 7), *range(0, last, 61), last}:
        for end in (0, 1) if node else (0,):  # of the periods that begin and that end there
            blocked, room = replace(clearance), clearance.limits.available.copy()
            room[end, node - end, 0] = -1.0
            vars(blocked.limits)["available"] = room
            assert not Continuation(blocked).margin_at(0, safety.start).inside, (node, end)


def test_limits_that_are_not_worked_out_are_never_the_tightest(period, monkeypatch):
    safety = small_safety(period)
    starts = [share * safety.start for share in (0.0, 0.5, 1.0, 2.0, 5.0, 20.0)]
    margins = [safety.recoverable.margin_at(k, each) for each in starts for k in (0, 5)]
    assert {margin.inside for margin in margins} == {True, False}
    monkeypatch.setattr(continuation, "FIRST", 10**9)
    for margin, whole in zip(
        margins, [safety.recoverable.margin_at(k, x) for x in starts for k in (0, 5)], strict=True
    ):
        assert (margin.limit, margin.time) == (whole.limit, whole.time)
        assert margin.value == pytest.approx(whole.value, rel=1e-12)


def test_all_of_a_tail_that_is_flown_again_lies_ahead_of_every_node_in_it(period):
    clearance = small_safety(period).clearance
    blocked, room = replace(clearance), clearance.limits.available.copy()
    room[0, clearance.planned * clearance.q + 1, 0] = -1.0
    vars(blocked.limits)["available"] = room
    for late in (0, 1, 5):
        first = clearance.planned + late
        assert Continuation(clearance).margin_at(first, 0 * small_safety(period).start).inside
        assert not Continuation(blocked).margin_at(first, 0 * small_safety(period).start).inside, late


def test_commands_of_recoverable_errors_keep_below_what_errors_of_thrusters_are_booked_for():
    assignments = ["thrusters.magnitude_error=0.05", "thrusters.mass_error=0.02"]
    safety = get_safety(load_scenario(TINY).with_assignments(assignments).problem())
    tracking, sets, m = safety.tracking, safety.recoverable, 2
    need = tracking.disturbance(tracking.commands)[:-1, :m] + tracking.noise
    rows, rng = tracking.gain @ tracking.transitions, np.random.default_rng(0)
    ways = np.vstack([rng.normal(size=(60, 4)), *(rows[lag] for lag in (0, 3, 10, 20))])
    ways = ways / np.linalg.norm(ways @ tracking.W.T, axis=1, keepdims=True)
    below, above = np.full(len(ways), 0.5 * sets.radius(0)), np.full(len(ways), 1e3 * sets.radius(0))
    for _ in range(24):
        inside = sets.contains(0, (middle := (below * above) ** 0.5)[:, None] * ways)
        below, above = np.where(inside, middle, below), np.where(inside, above, middle)
    commanded = np.abs(np.einsum("lmn,rn->rlm", rows, below[:, None] * ways)) + need
    share = (commanded / tracking.feedback_bound).max(axis=(1, 2))
    assert np.all(share <= 1) and share.max() > 0.9


@pytest.mark.parametrize("kind", ["polytope", "ball"])
def test_round_off_of_the_reference_is_needed_anew_at_every_step(kind, tmp_path):
    safety = synthesised(152, tmp_path)[1].safety
    clearance, tracking, q = safety.clearance, safety.tracking, safety.clearance.q
    assert safety.problem.system.w_max == 0  # so that nothing else is needed from no error
    rows = np.vstack([clearance.obstacle_rows[0], tracking.gain, -tracking.gain])
    lags = [np.linalg.matrix_power(tracking.flow.phi, steps * q) for steps in range(8)]
    worst, room = sum(np.abs(rows @ phi) for phi in lags), rooms(safety, 8 * q)
    for size in (1e-9, 1e-6, 1e-4):
        rounding = size * np.abs(safety.reference.chi).max(axis=0)
        reference = replace(safety.reference)
        vars(reference)["rounding"] = np.tile(rounding, (reference.cells, 1))
        sets = get_recover(kind, replace(clearance, reference=reference), safety.bounds)
        printed = sets.margin_at(0, 0 * safety.start).value
        assert 1 - 1e6 * size < printed <= np.min(1 - worst @ rounding / room)


@pytest.mark.parametrize(
    ("value", "form", "down", "up"),
    [
        (0.99996, ".1%", "99.9%", "100.0%"),
        (1 - 2**-53, ".4g", "0.9999", "1"),
        (-0.00012345, ".4g", "-0.0001235", "-0.0001234"),
        (float("-inf"), ".4g", "-inf", "-inf"),
    ],
)
def test_proven_numbers_are_rounded_to_their_safe_side(value, form, down, up):
    assert (directed(value, form), directed(value, form, up=True)) == (down, up)


def test_shares_are_below_one_and_what_is_missing_has_the_unit_of_its_limit():
    assert slack_share(np.array([1e-20]), np.array([1.0]))[0] < 1
    texts = [quantity(limit, 0.12341) for limit in ("debris", "radial thrust", "input 1")]
    assert texts == ["0.1235 m", "0.1235 N", "0.1235"]
