"""Kinds of allocation: whatever their thrusts are, the inputs are made within the bounds that are stated."""

import copy
import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linprog, minimize

from polaris.certificate.model.allocation import Nozzles as Stated
from polaris.model.allocation import KINDS, NEAREST, PAIRS, PROGRAM, Allocation, Fault, cases
from polaris.model.errors import ScenarioError, SynthesisInfeasible
from polaris.model.thrusters import Nozzles
from polaris.runs.run import run
from polaris.scenario.scenario import load_scenario
from polaris.simulation.allocating import thrusts_of
from tests.polaris.forging import CERTIFICATE, COARSE, Forger
from tests.polaris.tiny import TINY

ERRORS = 0.05, 0.03, 0.02  # of magnitude, of direction [rad], of the mass


def drawn(seed, kind, faults=()):
    """Draw a canted, unequal layout of 4 to 16 nozzles in the plane or in space, opposite ones for pairs."""
    rng = np.random.default_rng(seed)
    m = 2 + seed % 2
    while True:
        count = int(rng.integers(m + 1, 9 if kind == PAIRS else 17))
        ways = rng.normal(size=(count, m)) * rng.uniform(0.3, 1.5, (count, 1)) * [1.0, 1.0, 0.4][:m]
        ways = np.vstack([ways, -ways]) if kind == PAIRS else ways
        limits = rng.uniform(0.02, 0.05, len(ways))
        try:
            allocation = Allocation.from_directions(ways, limits, rng.uniform(0.02, 0.06, m), faults, kind)
        except SynthesisInfeasible:
            continue
        return rng, Nozzles.from_errors(allocation, *ERRORS, 1e-3, bool(seed % 3), True)


def inputs(rng, allocation, count):
    """Draw inputs within the limits, corners and edges of them too."""
    u = rng.uniform(-1, 1, (count, len(allocation.u_max))) * rng.choice([1.0, 0.0], (count, 1), p=[0.9, 0.1])
    return np.vstack([u, 1.0 - 2.0 * allocation.signs, np.eye(len(allocation.u_max))]) * allocation.u_max


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", [1, *(pytest.param(i, marks=pytest.mark.slow) for i in (0, 2, 3, 4, 5))])
def test_thrusts_of_every_kind_lie_within_the_bounds_after_every_fault(kind, seed):
    faults = [[], [Fault("stuck_off", 0.0)], [Fault("loss", 0.5)]][seed % 3]
    rng, layout = drawn(seed, kind, faults)
    allocation, bounds, each = (
        layout.allocation,
        layout.bounds,
        np.column_stack([layout.error, layout.allocation.lengths]),
    )
    ones = np.column_stack([layout.error, np.ones(len(allocation.limits))])
    for case, (_, capacity) in enumerate(cases(allocation.limits, faults)):
        faulted = replace(allocation, limits=capacity, mixes=allocation.mixes[case : case + 1])
        if kind == PAIRS:  # those whose pair is whole
            paired = np.any(faulted.mixes > 0, axis=(0, 1, 2))
            faulted = replace(faulted, directions=allocation.directions * paired[:, None])
        u = inputs(rng, allocation, 12 if kind == PROGRAM else 60)
        f = thrusts_of(faulted, u)
        np.testing.assert_allclose(f @ allocation.directions, u, atol=1e-9 * allocation.u_max.max())
        assert np.all(f >= 0) and np.all(f <= capacity * (1 + 1e-9) + 1e-15)
        assert np.all(f @ each <= np.abs(u) @ bounds.T * (1 + 1e-9) + 1e-12)
        firing = np.where(f > 1e-9 * allocation.limits.max(), 1.0, 0.0)
        assert np.all(firing @ ones <= allocation.at_once(ones) + 1e-9)


@pytest.mark.parametrize("kind", [PROGRAM, NEAREST])
@pytest.mark.parametrize("seed", [0, *(pytest.param(i, marks=pytest.mark.slow) for i in (1, 2))])
def test_programs_are_solved_as_another_solver_does(kind, seed):
    rng, layout = drawn(seed, kind)
    allocation = layout.allocation
    for u in inputs(rng, allocation, 4):
        f = thrusts_of(allocation, u)
        if kind == PROGRAM:
            bounds = np.column_stack([0 * allocation.limits, allocation.limits])
            other = linprog(allocation.lengths, A_eq=allocation.directions.T, b_eq=u, bounds=bounds).fun
            assert f @ allocation.lengths == pytest.approx(other, rel=1e-7, abs=1e-12)
        else:  # no step that leaves the input as it is makes it less
            null = np.linalg.svd(allocation.directions.T)[2][len(u) :]
            table = np.vstack([null.T, -null.T]), np.append(-f, f - allocation.limits)
            within = {"type": "ineq", "fun": lambda c, table=table: table[0] @ c - table[1]}
            other = minimize(
                lambda c, f=f, null=null: np.sum((f + c @ null) ** 2), null[:, 0] * 0, constraints=within
            ).fun
            assert f @ f <= other * (1 + 1e-6) + 1e-12


@pytest.mark.parametrize("kind", [PROGRAM, NEAREST])
def test_no_thrusts_of_the_size_of_the_mixes_go_beyond_the_bounds(kind):
    """By another program: the most that errors of any thrusts are that make u and have no larger size."""
    rng, layout = drawn(3, kind)
    allocation, reached = layout.allocation, 0.0
    for u in inputs(rng, allocation, 5)[:8]:
        f = np.maximum(u, 0) @ allocation.mixes[0, 0] + np.maximum(-u, 0) @ allocation.mixes[0, 1]
        size = f @ allocation.lengths if kind == PROGRAM else np.linalg.norm(f)
        for column, bound in zip(layout.error.T, np.abs(u) @ layout.bounds[:-1].T, strict=True):
            budget = {"A_ub": allocation.lengths[None], "b_ub": [size]} if kind == PROGRAM else {}
            capacity = np.minimum(allocation.limits, np.inf if kind == PROGRAM else size)
            limits = np.column_stack([0 * allocation.limits, capacity])
            worst = linprog(-column, A_eq=allocation.directions.T, b_eq=u, bounds=limits, **budget)
            if kind == PROGRAM:
                assert -worst.fun <= bound * (1 + 1e-7) + 1e-12
                reached = max(reached, -worst.fun / max(bound, 1e-12))
            assert f @ column <= bound * (1 + 1e-9)
    assert kind == NEAREST or reached > 0.6


@pytest.mark.parametrize("kind", KINDS)
def test_the_checker_derives_the_bounds_of_the_synthesis(kind):
    for seed in (0, 1):
        _, layout = drawn(seed, kind, [Fault("stuck_off", 0.0)] * seed)
        allocation = layout.allocation
        table = {name: getattr(allocation, name).tolist() for name in ("directions", "limits", "mixes")} | {
            "kind": kind
        }
        table |= {"multipliers": layout.multipliers.tolist()} if allocation.solves else {}
        claimed = Stated(table, layout.along, layout.across, layout.mass)
        bounds = np.array([[float(x) for x in row] for row in claimed.bounds])
        np.testing.assert_allclose(bounds, layout.bounds, rtol=1e-9, atol=1e-12)
        derived = [float(x) for x in claimed.at_once(claimed.largest)]
        np.testing.assert_allclose(derived, allocation.at_once(layout.largest), rtol=1e-9)


ROUND = [[float(np.cos(a)), float(np.sin(a)) * 0.7] for a in np.arange(3) * np.pi / 3 + 0.2]
SIX = (f"thrusters.directions={ROUND + [[-x, -y] for x, y in ROUND]}", "thrusters.thrust_max_N=3.0")
"""Three pairs of opposite thrusters in the plane, weaker along the second axis."""

UNPAIRED = [*SIX, f"thrusters.directions={[*ROUND, [0.0, -1.0], [-1.0, 0.0]]}"]

WRONG = (
    "thrusters.magnitude_error=0.02",
    "thrusters.mass_error=0.01",
    "thrusters.impulse_bit_N_s=0.001",
    'thrusters.remainder="carried"',
    'thrusters.pulse="centred"',
    'faults=[{kind="stuck_off"},{kind="loss",share=0.02,isolation_s=0.5}]',
)


@pytest.mark.parametrize(
    "kind", [PROGRAM, *(pytest.param(x, marks=pytest.mark.slow) for x in (PAIRS, NEAREST))]
)
def test_every_kind_is_verified_and_none_passes_for_another(kind, tmp_path):
    assignments = [
        "tracking.R=[60,60]",
        "simulation.runs=2",
        COARSE,
        *SIX,
        *WRONG,
        f'thrusters.allocation="{kind}"',
    ]
    forger = Forger(run(TINY, tmp_path / "run", overrides=assignments).path, tmp_path)
    assert forger.judge({}).outcome == "VERIFIED"
    assert sum(line.startswith("allocation: ") for line in forger.honest["assumptions"]) == 1

    def forged(change):
        data = copy.deepcopy(forger.honest)
        change(data["system"])
        return forger.judge({CERTIFICATE: json.dumps(data)})

    def lower(system):
        system["allocation"]["limits"][2] = (float.fromhex(system["allocation"]["limits"][2]) * 0.99).hex()

    def left_out(system):
        system["transients"][0]["pushes"].pop()

    def without(system):
        system["allocation"]["mixes"].pop()

    def less(system):
        old = system["allocation"]["mixes"][0][0][0]
        system["allocation"]["mixes"][0][0][0] = [(float.fromhex(x) * 0.99).hex() for x in old]

    def unstated(system):
        if "multipliers" not in system["allocation"]:
            system["allocation"]["mixes"].reverse()
        system["allocation"].pop("multipliers", None)

    def few(system):
        system["allocation"].setdefault("multipliers", [[[(0.0).hex()] * 2] * 3] * 5).pop()

    for change in (lower, left_out, without, less, unstated, few):
        assert forged(change).claim == "system", change.__name__
    assert forged(lambda system: system["allocation"].pop("kind")).outcome == "REJECTED"
    for other in (each for each in KINDS if each != kind):
        text = (forger.run / "scenario.toml").read_text().replace(f'"{kind}"', f'"{other}"')
        assert forger.judge({"scenario.toml": text}).claim == "system"
        assert (
            forged(lambda system, other=other: system["allocation"].update(kind=other)).outcome == "REJECTED"
        )


@pytest.mark.parametrize(
    ("assignments", "field"),
    [
        ([*UNPAIRED, 'thrusters.allocation="pseudo_inverse"'], "thrusters.directions"),
        (['thrusters.allocation="nearest"'], "thrusters.allocation"),
    ],
)  # fmt: skip
def test_layouts_that_a_kind_cannot_serve_are_refused_by_name(assignments, field):
    with pytest.raises(ScenarioError) as error:
        load_scenario(TINY).with_assignments(assignments)
    assert error.value.field == field


def test_pairs_that_do_not_push_every_way_once_one_is_broken_are_refused():
    ways = np.vstack([np.eye(2), -np.eye(2)])
    assert Allocation.from_directions(ways, np.ones(4), np.ones(2), [], PAIRS).mixes.max() == 1.0
    extra = np.vstack([ways, [[0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5], [0.5, -0.5]]])
    assert (
        Allocation.from_directions(
            extra, np.ones(8), np.ones(2), [Fault("stuck_off", 0.0)], PAIRS
        ).u_max.min()
        > 0.5
    )
    with pytest.raises(SynthesisInfeasible, match="do not span every direction"):
        Allocation.from_directions(ways, np.ones(4), np.ones(2), [Fault("stuck_off", 0.0)], PAIRS)
