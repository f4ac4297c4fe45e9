"""References of their own: what the package makes of a scenario passes, in any units; nothing else does."""

from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
import pytest

pytest.importorskip("flint")

import flint

from polaris.certificate.kernel.balls import PRECISION
from polaris.certificate.kernel.verdict import Rejected, Undecided
from polaris.certificate.model.references import check_references
from polaris.model.hill import clohessy_wiltshire, elliptical_nmt
from polaris.model.system import LinearSystem
from polaris.planning.reference import Reference
from polaris.scenario.experimental import _settled
from reach.numerics.linear import discretize

STEPS = 12


@pytest.fixture(autouse=True)
def precision():
    before = flint.ctx.prec
    flint.ctx.prec = PRECISION
    yield
    flint.ctx.prec = before


def judged(system, delta, law, kind, chi, nu, missed=False, **spec):
    """Outcome of the check of one reference."""
    hill = system.mean_motion is not None
    document = SimpleNamespace(
        A=system.A.tolist(),
        B=system.B.tolist(),
        C=system.position.tolist(),
        D=system.D.tolist(),
        u_max=system.u_max.tolist(),
        w_max=0.0,
        estimate=(),
        shares=(0.0, 0.0, 0.0),
        same_shares=False,
        carried_impulse=0.0,
        pulse_place="",
        observer=None,
        bits=(),
        prompt_bits=(),
        bias=(),
        allocation=None,
        timing={},
        transients=[],
        delta=delta,
        q=1,
        steps=STEPS,
        system_kind="clohessy_wiltshire" if hill else "linear",
        mean_motion=system.mean_motion,
        mass=system.mass,
        input_names=list(system.input_names),
    )
    law = SimpleNamespace(name="law", gain=np.asarray(law).tolist(), states=chi.tolist(), inputs=nu.tolist())
    scenario = {"initial_set": {"center": chi[0].tolist()}, "goal": {}}

    def goal(_, document, x, claim, whose):
        if missed:
            raise Rejected(claim, f"{whose} misses")

    try:
        with patch("polaris.certificate.model.references.check_goal", goal):
            check_references(document, law, scenario, {"reference": {"kind": kind, **spec}})
    except (Rejected, Undecided) as error:
        assert error.claim == "controllers"
        return type(error).__name__
    return "holds"


def random_system(rng):
    """A plant, stable or not, in units of all sizes, and a step."""
    n, m = int(rng.integers(1, 6)), int(rng.integers(1, 4))
    x, u, t = 10.0 ** rng.uniform(-3, 3, n), 10.0 ** rng.uniform(-3, 3, m), 10.0 ** rng.uniform(-3, 3)
    A, B = rng.normal(size=(n, n)), rng.normal(size=(n, m))
    if rng.random() < 0.3:  # a chain of integrators
        A, B = np.eye(n, k=1), np.vstack([np.zeros((n - 1, m)), np.ones((1, m))])
    system = LinearSystem(A * x[:, None] / x / t, B * x[:, None] / u / t, np.eye(n), u, C=np.eye(n)[:1])
    return system, 0.5 * t, x, u


SEEDS = [*range(15), *(pytest.param(s, marks=pytest.mark.slow) for s in range(15, 300))]


@pytest.mark.parametrize("seed", SEEDS)
def test_plans_of_random_plants(seed):
    rng = np.random.default_rng(seed)
    system, delta, x, u = random_system(rng)
    K = np.zeros((system.m, system.n))
    made = Reference.propagate(
        system, delta, rng.normal(size=system.n) * x, rng.uniform(-0.9, 0.9, (STEPS, system.m)) * u
    )
    assert judged(system, delta, K, "unaware", made.chi, made.nu) == "holds"
    assert judged(system, delta, K, "unaware", made.chi, made.nu, missed=True) == "Rejected"
    k, i = 1, int(rng.integers(system.n))
    moved = made.chi.copy()
    moved[k, i] += 1e-4 * np.abs(made.chi[k]).max()
    assert judged(system, delta, K, "unaware", moved, made.nu) != "holds"
    pushed = made.nu.copy()
    pushed[k, int(rng.integers(system.m))] *= 1.5
    assert judged(system, delta, K, "unaware", made.chi, pushed) != "holds"
    assert judged(system, delta, K, "unaware", made.chi[1:], made.nu[1:]) == "Rejected"


@pytest.mark.parametrize("seed", SEEDS)
def test_setpoints_of_random_plants(seed):
    rng = np.random.default_rng(seed)
    system, delta, x, u = random_system(rng)
    K = rng.normal(size=(system.m, system.n)) * u[:, None] / x
    state = rng.normal(size=system.n) * x
    made = _settled(system, K, state, STEPS, delta, "reference")
    assert judged(system, delta, K, "setpoint", made.chi, made.nu, state=state.tolist()) == "holds"
    other = state.copy()
    other[int(rng.integers(system.n))] *= 1.01
    assert judged(system, delta, K, "setpoint", made.chi, made.nu, state=other.tolist()) == "Rejected"
    drifting = made.chi + rng.normal(size=system.n) * x
    balanced = made.nu + (made.chi - drifting)[:-1] @ K.T  # the same command, from a state that does not stay
    assert judged(system, delta, K, "setpoint", drifting, balanced, state=state.tolist()) == "Rejected"


@pytest.mark.parametrize("seed", range(10))
def test_natural_motions(seed):
    rng = np.random.default_rng(seed)
    eta, delta = 10.0 ** rng.uniform(-3.5, -2), rng.uniform(1.0, 100.0)
    system = clohessy_wiltshire(eta, 10.0, 0.1)
    b, psi, c, zeta = (
        rng.uniform(0, 500),
        rng.uniform(-9, 9),
        rng.uniform(0, 50) * (seed % 2),
        rng.uniform(-9, 9),
    )
    spec = {"semi_minor_m": b, "phase_rad": psi, "cross_track_m": c, "cross_phase_rad": zeta}

    def check(chi, nu, **other):
        return judged(system, delta, np.zeros((3, 6)), "nmt", chi, nu, **(spec | other))

    made = Reference.propagate(system, delta, elliptical_nmt(eta, b, psi, c, zeta), np.zeros((STEPS, 3)))
    assert check(made.chi, made.nu) == "holds"
    assert check(made.chi, made.nu, semi_minor_m=b * 1.001) == "Rejected"
    assert check(made.chi, made.nu, phase_rad=psi + 1e-3) == "Rejected"
    assert check(made.chi, made.nu, cross_track_m=c + 0.01) == "Rejected"
    nudged = Reference.propagate(system, delta, made.chi[0], np.full((STEPS, 3), 1e-6))
    assert check(nudged.chi, nudged.nu) == "Rejected"
    drifting = made.chi[0] + np.array([0.0, 0.0, 0.0, 0.0, 1e-5, 0.0])
    made = Reference.propagate(system, delta, drifting, np.zeros((STEPS, 3)))
    assert check(made.chi, made.nu) == "Rejected"


def test_inputs_in_small_units_cost_the_motion_no_digits():
    """A state that decays fast beside a large entry of B: its exponential is exact for its own size."""
    A, B = (
        np.array([[0.0, 1.0, 0.0], [0.03, 0.05, 1.0], [0.0, 0.0, -1.9361]]),
        np.array([[0.0], [0.0], [1e9]]),
    )
    np.testing.assert_allclose(
        discretize(A, B, 1.12)[0][2], [0, 0, np.exp(-1.9361 * 1.12)], rtol=5e-14, atol=0
    )
