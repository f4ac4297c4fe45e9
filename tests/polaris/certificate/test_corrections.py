"""Spending of S in a whole flight (Proposition 15 (d)): driven to its worst, and derived by the checker."""

from dataclasses import replace
from pathlib import Path

import flint
import numpy as np
import pytest
from scipy.linalg import expm

from polaris.certificate.checker import verify
from polaris.certificate.claims.argument import Argument
from polaris.certificate.files.artefacts import FileClaims
from polaris.certificate.files.document import Document
from polaris.certificate.kernel.verdict import Record, Rejected
from polaris.certificate.model.plants import precision_for
from polaris.model.thrusters import Thrusters
from polaris.runs.certificate import certificate
from polaris.runs.schedule import fly_schedule, write_run
from polaris.runs.stages import Stages
from polaris.scenario.scenario import load_scenario
from polaris.simulation.falsification.search import falsify
from polaris.synthesis.safety.corrections import Corrections
from polaris.synthesis.safety.get_safety import get_safety
from polaris.synthesis.schedule.abort_branch import AbortBranch
from polaris.synthesis.schedule.synthesize import synthesize
from reach.sets.zonotope import Zonotope
from tests.polaris.synthesis.schedule.test_powered_abort import NOISE, OWN, proven
from tests.polaris.synthesis.sources.test_transients import LATE, SOFT
from tests.polaris.tiny import TINY

SCENE = Path(__file__).parents[1] / "data" / "aborts.toml"
ERRORS = ["thrusters.magnitude_error=0.05", "thrusters.mass_error=0.03"]


class Driven:
    """S's loop on states that are estimated at once, under inputs that an adjoint chooses."""

    def __init__(self, tracking, inputs, start, kick, rng):
        system, h = tracking.system, tracking.flow.h
        n, m = system.B.shape
        exact = expm(np.block([[system.A, system.B], [np.zeros((m, n + m))]]) * h)
        self.phi, self.gamma, self.gain, self.h = exact[:n, :n], exact[:n, n:], tracking.gain, h
        self.system, self.inputs, self.start, self.kick = system, inputs, start, kick
        count = len(inputs)
        self.when = int(rng.integers(0, count // 2))
        self.noise, self.error = rng.choice([-1.0, 1.0], (count, n)), rng.choice([-1.0, 1.0], (count, m))
        self.w, self.corner = np.zeros((count, n)), rng.choice([-1.0, 1.0], start.G.shape[1])
        self.side = rng.choice([-1.0, 1.0], n)

    def fly(self):
        """Return commands and what is applied, (periods, m) each."""
        e, thrusters = self.start.c + self.start.G @ self.corner, self.system.thrusters
        commands, applied = [], []
        for i, u in enumerate(self.inputs):
            e = e + (i == self.when) * self.side * self.kick
            answer = -self.gain @ (e + self.noise[i] * self.system.navigation)
            correction = answer + self.error[i] * thrusters.error(np.abs(u + answer))
            commands.append(u + answer)
            applied.append(u + correction)
            e = self.phi @ e + self.gamma @ correction + self.w[i]
        return np.array(commands), np.array(applied)

    def climb(self):
        """Return what is spent, and choose inputs by the adjoint of that."""
        commands, applied = self.fly()
        p, thrusters = np.zeros(len(self.phi)), self.system.thrusters
        table = thrusters.table(applied.shape[1])
        for i in reversed(range(len(commands))):
            along = self.system.D.T @ p
            size = np.linalg.norm(along)
            self.w[i] = self.system.D @ along / (size or 1.0) * self.system.w_max * self.h
            turn = np.sign(applied[i]) + self.gamma.T @ p
            error, self.error[i] = self.error[i], np.where(turn >= 0, 1.0, -1.0)
            slope = turn + np.sign(commands[i]) * (table.T @ (error * turn))
            self.noise[i] = np.where(self.gain.T @ slope <= 0, 1.0, -1.0)
            p = self.phi.T @ p - self.gain.T @ slope
            if i == self.when:
                self.side = np.where(p >= 0, 1.0, -1.0)
        self.corner = np.where(self.start.G.T @ p >= 0, 1.0, -1.0)
        return float(np.abs(applied).sum())


@pytest.fixture(scope="module")
def tracking():
    return get_safety(load_scenario(TINY).with_assignments([*SOFT, *ERRORS, NOISE, LATE]).problem()).tracking


@pytest.mark.parametrize("seed", range(3))
def test_a_loop_that_is_driven_to_its_worst_spends_no_more(tracking, seed):
    """One number of the bound each: what disturbs always, starts, inputs of a path, and a fault once."""
    rng = np.random.default_rng(seed)
    corrections, count = Corrections(tracking), int(rng.integers(20, 120))
    start = Zonotope(rng.normal(size=4) * 0.01, rng.normal(size=(4, 7)) * 0.02)
    inputs = np.repeat(rng.uniform(-0.2, 0.2, (-(-count // 4), 2)), 4, axis=0)[:count]
    kick = np.abs(tracking.transients[seed % 2].added[0]).sum(axis=1)
    stack = Zonotope(start.c[None], start.G[None])
    parts = {
        "mean": (count * corrections.mean, 0 * inputs, Zonotope.point(start.c * 0), 0 * kick),
        "once": (corrections.once(stack, count), 0 * inputs, start, 0 * kick),
        "planned": (corrections.planned(inputs), inputs, Zonotope.point(start.c * 0), 0 * kick),
        "late": (corrections.late_fault_thrust(count), 0 * inputs, Zonotope.point(start.c * 0), kick),
    }
    whole = sum(part[0] for part in parts.values())
    for name, (bound, path, from_set, kicked) in parts.items():
        bound += count * corrections.mean * (name != "mean")
        driven = Driven(tracking, path, from_set, kicked, rng)
        delta_v = max(driven.climb() for _ in range(8))
        assert 0.35 * bound < delta_v <= bound, name
    driven = Driven(tracking, inputs, start, kick, rng)
    assert 0.35 * whole < max(driven.climb() for _ in range(8)) <= whole


def test_the_checker_derives_it_and_refuses_less(monkeypatch):
    """In some steps it is less than the sum of all periods' bounds, and the claim is the lesser one."""
    scenario = load_scenario(TINY).with_assignments([*SOFT, *ERRORS, LATE, OWN])
    schedule = synthesize(scenario)
    ways = schedule.powered.ways
    with monkeypatch.context() as without:
        without.setattr(AbortBranch, "_together", lambda self, takeover, end: np.inf)
        before = synthesize(scenario).powered.ways
    shares = [
        a.delta_v / b.delta_v if a.branch is not None else np.nan for a, b in zip(ways, before, strict=True)
    ]
    k = int(np.nanargmin(shares))
    assert shares[k] < 0.9
    assert proven(schedule) and falsify(schedule, 200, 0).failure is None
    document = Document(certificate(schedule, "tiny"))

    def argued(share):
        aborts = [way.delta_v if way.branch is not None else None for way in ways]
        aborts[k] *= share
        with flint.ctx.workprec(precision_for(document)):
            Argument(document, Record(), FileClaims(aborts=aborts)).run()

    argued(1.0)
    with pytest.raises(Rejected, match=f"abort in step {k}: .*claimed"):
        argued(0.93)


def test_errors_that_feed_on_themselves_have_no_bound(tracking):
    """Errors of thrusters that cause as much as they answer to leave no bound on sums of commands."""
    assert Corrections(tracking).mean is not None
    wrong = replace(tracking, system=replace(tracking.system, thrusters=Thrusters(along=0.9)))
    assert Corrections(wrong).mean is None


@pytest.mark.slow
def test_from_most_steps_of_an_approach_with_all_errors_an_abort_fits_its_budget(tmp_path):
    """All errors at once, two late faults, delay and pulses; 3 m/s are allowed, and 18 sum up of periods."""
    scenario = load_scenario(SCENE)
    mission = fly_schedule(scenario, Stages())
    schedule = mission.schedule
    assert len(proven(schedule)) >= 20 and len(schedule.powered.branches) <= 8
    write_run(tmp_path / "run", scenario, schedule, mission.flown)
    assert verify(tmp_path / "run").outcome == "VERIFIED"
    assert falsify(schedule, 2000, 0).failure is None
