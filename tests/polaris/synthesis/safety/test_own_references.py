"""References of their own: what the package makes of a scenario passes, in any units; nothing else does."""

from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
import pytest

pytest.importorskip("flint")

import flint

from polaris import LinearSystem, Reference, clohessy_wiltshire, elliptical_nmt
from polaris.certificate.kernel.balls import PRECISION
from polaris.certificate.kernel.verdict import Rejected, Undecided
from polaris.certificate.model.references import check_references
from polaris.scenario.experimental import at_rest

STEPS = 12


@pytest.fixture(autouse=True)
def precision():
    before = flint.ctx.prec
    flint.ctx.prec = PRECISION
    yield
    flint.ctx.prec = before


NOTHING = dict.fromkeys(("estimate", "bits", "prompt_bits", "bias"), ()) | {
    "pulse_place": "",
    "observer": None,
}
NOTHING |= {
    "w_max": 0.0,
    "shares": (0.0, 0.0, 0.0),
    "same_shares": False,
    "carried_impulse": 0.0,
    "allocation": None,
}


def judged(system, delta, law, kind, chi, nu, missed=False, **spec):
    """Outcome of the check of one reference."""
    hill = system.mean_motion is not None
    document = SimpleNamespace(
        **NOTHING,
        **{key: getattr(system, key).tolist() for key in ("A", "B", "D", "u_max")},
        **{key: getattr(system, key) for key in ("mean_motion", "mass")},
        C=system.position.tolist(),
        timing={},
        transients=[],
        delta=delta,
        q=1,
        steps=STEPS,
        system_kind="clohessy_wiltshire" if hill else "linear",
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


SEEDS = range(15)


@pytest.mark.parametrize("seed", SEEDS)
def test_plans_of_random_plants(seed):
    rng = np.random.default_rng(seed)
    system, delta, x, u = random_system(rng)
    K = np.zeros((system.m, system.n))
    path = Reference.propagate(
        system, delta, rng.normal(size=system.n) * x, rng.uniform(-0.9, 0.9, (STEPS, system.m)) * u
    )
    assert judged(system, delta, K, "unaware", path.chi, path.nu) == "holds"
    assert judged(system, delta, K, "unaware", path.chi, path.nu, missed=True) == "Rejected"
    k, i = 1, int(rng.integers(system.n))
    states = path.chi.copy()
    states[k, i] += 1e-4 * np.abs(path.chi[k]).max()
    assert judged(system, delta, K, "unaware", states, path.nu) != "holds"
    inputs = path.nu.copy()
    inputs[k, int(rng.integers(system.m))] *= 1.5
    assert judged(system, delta, K, "unaware", path.chi, inputs) != "holds"
    assert judged(system, delta, K, "unaware", path.chi[1:], path.nu[1:]) == "Rejected"


@pytest.mark.parametrize("seed", SEEDS)
def test_setpoints_of_random_plants(seed):
    rng = np.random.default_rng(seed)
    system, delta, x, u = random_system(rng)
    K = rng.normal(size=(system.m, system.n)) * u[:, None] / x
    state = rng.normal(size=system.n) * x
    path = at_rest(system, K, state, STEPS, delta, "reference")
    assert judged(system, delta, K, "setpoint", path.chi, path.nu, state=state.tolist()) == "holds"
    other = state.copy()
    other[int(rng.integers(system.n))] *= 1.01
    assert judged(system, delta, K, "setpoint", path.chi, path.nu, state=other.tolist()) == "Rejected"
    drifting = path.chi + rng.normal(size=system.n) * x
    balanced = path.nu + (path.chi - drifting)[:-1] @ K.T  # the same command, from a state that does not stay
    assert judged(system, delta, K, "setpoint", drifting, balanced, state=state.tolist()) == "Rejected"


@pytest.mark.parametrize("seed", range(6))
def test_natural_motions(seed):
    rng = np.random.default_rng(seed)
    eta, delta = 10.0 ** rng.uniform(-3.5, -2), rng.uniform(1.0, 100.0)
    system = clohessy_wiltshire(eta, 10.0, 0.1)
    names = "semi_minor_m", "phase_rad", "cross_track_m", "cross_phase_rad"
    b, psi, c, zeta = rng.uniform([0, -9, 0, -9], [500, 9, 50, 9]) * [1, 1, seed % 2, 1]
    spec = dict(zip(names, map(float, (b, psi, c, zeta)), strict=True))
    start, inputs = elliptical_nmt(eta, b, psi, c, zeta), np.zeros((STEPS, 3))

    def check(shift=0.0, push=0.0, **other):
        path = Reference.propagate(system, delta, start + shift * np.eye(6)[4], inputs + push)
        return judged(system, delta, np.zeros((3, 6)), "nmt", path.chi, path.nu, **(spec | other))

    assert check() == "holds"
    wrong = {"semi_minor_m": b * 1.001}, {"phase_rad": psi + 1e-3}, {"cross_track_m": c + 0.01}
    for lie in (*wrong, {"push": 1e-6}, {"shift": 1e-5}):
        assert check(**lie) == "Rejected", lie
