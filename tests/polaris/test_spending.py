"""Bounds on the velocity change (Proposition 14 (c)): linear loops all at once, attacked, derived twice."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks import tenfold
from polaris.model.thrusters import Thrusters
from polaris.runs.case import replay, write_case
from polaris.scenario.scenario import load_scenario
from polaris.simulation.falsification.attacks import Attacker
from polaris.simulation.falsification.search import falsify
from polaris.synthesis.schedule import spending
from polaris.synthesis.schedule.spending import Spell, peak, spent, together
from polaris.synthesis.schedule.synthesize import synthesize

from ..kept import kept
from .tiny import TINY

SAMPLED = ["feedback.period_s=0.25"]
NOISY = [*SAMPLED, "navigation.state_error=[0.01, 0.01, 0.005, 0.005]"]
WEAK = [*SAMPLED, "thrusters.magnitude_error=0.03", "thrusters.impulse_bit_N_s=0.002"]
CARRIED = [*WEAK, "thrusters.remainder=carried"]


def tiny(*more):
    """The schedule of the tiny scene with overrides."""
    return kept("-".join(["tiny", *more]), lambda: synthesize(load_scenario(TINY).with_assignments(more)))


def responses(seed):
    """Impulse responses of loops, well damped or not, and noise."""
    rng = np.random.default_rng(seed)
    pole = rng.uniform(0.5, 0.99) * np.exp(1j * rng.uniform(0, np.pi))
    ring = np.real(rng.normal() * pole ** np.arange(1, int(rng.integers(2, 400))))
    return np.append(1.0, ring) if seed % 2 else np.append(ring, rng.normal(size=5))


@pytest.mark.parametrize("seed", range(6))
def test_no_frequency_exceeds_the_peak_of_a_response(seed):
    """Whatever lies between the frequencies looked at; it is a few per cent above, and in balls the same."""
    response = responses(seed)
    most = np.abs(np.fft.rfft(response, 1 << 16)).max()
    assert most <= peak(response[None]) <= 1.2 * most
    flint = pytest.importorskip("flint")
    checked = pytest.importorskip("polaris.certificate.claims.spending")
    found = checked.peak([flint.arb(x) for x in response])
    assert 1 - 1e-9 <= float(found.mid()) / peak(response[None]) <= 1.004  # its last part adds up
    assert checked.peak([flint.arb(0, 1e-20)]) < 1e-19  # which may be zero
    assert checked.peak([flint.arb(0)]) == 0  # of one period, which answers nothing


@pytest.mark.parametrize("errors", [SAMPLED, NOISY, WEAK, CARRIED], ids=["none", "estimate", "made", "left"])
def test_the_worst_flights_spend_most_of_what_is_proven(errors):
    schedule = tiny(*errors)
    attacker = Attacker.of(schedule, False, np.random.default_rng(1))
    most = float(attacker.spending(20).fly(attacker.flight).delta_v.max())
    by_chance = float(attacker.random(20).fly(attacker.flight).delta_v.max())
    assert by_chance < most <= schedule.delta_v[1] * (1 + 1e-9)
    assert most > 0.6 * schedule.delta_v[1]


def test_periods_cannot_all_be_the_worst():
    """The bound of linear steps is less than the sum of its periods', where errors are renewed."""
    schedule = tiny(*NOISY)
    scale = schedule.safety.tracking.flow.h / schedule.safety.problem.system.mass
    spells = [Spell.of(schedule.controllers[step.mode], step.tube, step.k) for step in schedule.steps]
    apart = sum(spell.most.sum() for spell in spells) * scale
    assert schedule.delta_v[1] < 0.9 * apart
    run = [spell for spell in spells if spell.law is spells[0].law and spell.errors]
    assert together(run, 7) <= together(run, 8) and spent(run, 0) == 0


def test_a_bound_that_is_too_small_is_found_out_and_flown_again(monkeypatch, tmp_path):
    """Errors that are left out of the bound are flown all the same."""
    schedule = tiny(*NOISY)
    assert falsify(schedule, 700, seed=3).failure is None
    without = replace(schedule)  # nothing of what was worked out
    monkeypatch.setattr(spending, "together", lambda run, count: sum(s.middle.sum() for s in run))
    found = falsify(without, 700, seed=3)
    assert found.failure.kind == "velocity change" and "velocity change" in str(found.failure)
    case = write_case(tmp_path / "case.json", load_scenario(TINY).with_assignments(NOISY), found)
    assert str(replay(case)[0]) == str(found.failure)
    monkeypatch.undo()
    assert replay(case)[0] is None


def test_attacks_count_with_errors_of_thrusters_that_grow_with_commands(monkeypatch):
    """About a flight they go as far as without that, or further; what they count is the derivative."""
    schedule, rng = tiny(*SAMPLED, "thrusters.magnitude_error=0.1"), np.random.default_rng(0)
    attacker = Attacker.of(schedule, False, rng)
    rows, end = attacker.rows, attacker.flight.steps

    def reached():
        about, targets = None, np.full(len(rows), end)
        for _ in range(3):
            about = attacker._towards(rows, targets, about).fly(attacker.flight)
        return np.einsum("rn,rn->r", about.states[:, end], rows)

    with_growth = reached()
    monkeypatch.setattr(Thrusters, "slope", lambda self, u, weights: np.zeros_like(weights))
    gained = (with_growth - reached()) / np.ptp(with_growth)
    assert gained.min() > -1e-9 and gained.max() > 1e-5
    monkeypatch.undo()
    thrusters, u, weights = Thrusters(0.1, 0.05, 0.2), rng.normal(size=(4, 3)), rng.uniform(0, 2, (4, 3))
    small = 1e-6 * np.eye(3)[:, None]
    change = ((thrusters.part(u + small) - thrusters.part(u - small)) * weights).sum(axis=-1).T / 2e-6
    assert thrusters.slope(u, weights) == pytest.approx(change, abs=1e-8)


@pytest.mark.slow
def test_the_table_of_tightness_has_a_row_for_every_source_and_no_share_above_all():
    """One scene of the table in docs/guarantees.md; the others give the rest of its figures."""
    from benchmarks import tightness

    told = [row.split("|")[1:-1] for row in tightness.rows((5000,))]
    page = tightness.PLACE.read_text(encoding="utf-8").split(tightness.BEGIN)[1].split(tightness.END)[0]
    assert [row.split("|")[1] for row in page.splitlines()[2:]] == [cells[0] for cells in told]
    shares = np.array([[float(cell.strip(" %")) for cell in cells[3:]] for cells in told])
    assert np.all(shares <= 100)
    for cells, (used, *_, alike, unmerged, _) in zip(told, shares, strict=True):
        assert alike <= used <= unmerged + 1, cells[0]  # each lets a flight do more


@pytest.mark.slow
@pytest.mark.parametrize("scene", tenfold.SCENES)
def test_sums_with_all_errors_are_near_to_what_worst_cases_spend(scene):
    """Until the goal and per orbit: the figures of docs/guarantees.md."""
    from benchmarks import tightness

    found = tightness.sums(scene)
    assert all(1 <= ratio <= most for ratio, most in zip(found.ratios, (1.8, 3.0), strict=True)), found
    page = tightness.PLACE.read_text(encoding="utf-8").split(tightness.BEGIN_SUMS)[1]
    row = next(row for row in page.splitlines() if row.startswith(f"| {scene} |"))
    known = [float(cell) for cell in row.split("|")[2:-1]]
    assert [*found.until_goal, *found.per_orbit] == pytest.approx([known[i] for i in (0, 1, 3, 4)], abs=0.02)
