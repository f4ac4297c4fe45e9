"""Passive safety (Proposition 15) and upkeep: flown at their worst, forged claims, what is required."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from polaris import falsify, load_scenario, simulate, synthesize
from polaris.model.errors import PolarisError, SynthesisInfeasible
from polaris.runs.case import replay, write_case
from polaris.runs.certificate import certificate
from polaris.runs.files.tables import drift_text
from polaris.simulation.falsification.drifting import drifted, stopped
from polaris.synthesis.safety.passive import PassiveSafety
from polaris.synthesis.schedule.rules import CHECKED
from tests.polaris.closed_loops import held
from tests.polaris.corruptions import scaled
from tests.polaris.forging import COARSE, Forger, make
from tests.polaris.synthesis.sources.test_error_sources import exact
from tests.polaris.tiny import TINY
from tests.sizes import fewer


def drifting(scenario, drift, *more):
    """The schedule of a scene that asks for a drift of so many horizons."""
    time = drift * scenario.model.horizon.duration_s
    return synthesize(scenario.with_assignments([f"abort.drift_s={time}", *more]))


def flown_drifts(schedule, runs, seed):
    """Least distance of drifts from all unsafe sets, thrust stopping within clear steps; how many."""
    passive, safety = schedule.passive, schedule.safety
    system, delta, q = safety.problem.system, safety.problem.delta, safety.clearance.q
    rng = np.random.default_rng(seed)
    flights = simulate(schedule, runs, seed, substeps=8)
    least, count = np.inf, 0
    part = delta / 8
    for k in np.flatnonzero(passive.clear):
        node = k * q + int(rng.integers(0, q))
        law, share = schedule.controllers[schedule.modes[k]], rng.random()
        x = flights.states[:, node]
        Ad, Bd = held(system.A, system.B, (node - k * q) / q * delta)
        places = [
            Ad @ ref.chi[k] + Bd @ ref.nu[k]
            for ref in (safety.reference, getattr(law, "own", safety.reference))
        ]
        u = np.clip(law.command(k, *places, x), -system.u_max, system.u_max)
        Ad, Bd = held(system.A, system.B, share * delta / q)  # on to the instant at which thrust stops
        x = x @ Ad.T + u @ Bd.T
        t = k * delta + (node - k * q + share) / q * delta
        for item in passive.flight.sets:
            row = -item.normals[rng.integers(0, len(item.normals))] @ system.position
            steps = int(passive.flight.abort.horizon / part)
            way = np.array([row @ expm(system.A * part * (steps - j)) @ system.D for j in range(steps)])
            way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-300)
            Ad, Dd = held(system.A, system.D, part)
            y = x
            for j in range(steps + 1):
                cell = min(int((t + j * part) / delta), item.cells - 1)
                s = (t + j * part) / delta - cell
                b = item.offsets[cell, 0] * (1 - s) + item.offsets[cell, 1] * s
                least = min(least, float((y @ system.position.T @ item.normals.T - b).max(axis=1).min()))
                y = y @ Ad.T + (system.w_max * way[j] @ Dd.T if j < steps else 0.0)
            count += len(x)
    return least, count


def test_drifts_from_clear_steps_stay_clear():
    schedule = drifting(exact(5016), 0.5)
    passive = schedule.passive
    assert len(passive.drifts) == len(schedule.steps)
    least, count = flown_drifts(schedule, 12, 5016)
    assert count and least >= passive.least - 1e-3
    assert falsify(schedule, 200, 5016).failure is None


@pytest.mark.slow
def test_many_drifts_stay_clear():
    count, tight, seeds = 0, [], range(5017, fewer(5060, 5035))
    for seed in seeds:
        try:
            schedule = drifting(exact(seed), 0.7)
        except PolarisError:
            continue
        if schedule.passive.least is not None:
            least, _ = flown_drifts(schedule, 20, seed)
            assert least >= schedule.passive.least - 1e-3, seed
            count, tight = count + 1, [*tight, schedule.passive.least / least]
    assert count >= len(seeds) / 3 and np.median(tight) > 0.2


@pytest.fixture(scope="module")
def tiny():
    return drifting(load_scenario(TINY), 20 / 12)


def test_a_claim_that_is_too_wide_is_refuted(tiny):
    passive = tiny.passive
    assert not passive.clear.all() and passive.witness()["unsafe_set"] == "pillar"
    runs = simulate(tiny, 50, 0)
    bold = replace(passive, drifts=passive.drifts[2:3] * len(passive.drifts))
    wrong, honest = (
        drifted(each, runs, *stopped(each, runs, np.random.default_rng(0), 2000))[0]
        for each in (bold, passive)
    )
    assert wrong.broken and wrong.margin < 0 < passive.least <= honest.margin and not honest.broken


def test_a_drift_that_comes_too_close_can_be_flown_again(tiny, monkeypatch, tmp_path):
    scenario = load_scenario(TINY).with_assignments([f"abort.drift_s={tiny.passive.flight.abort.horizon}"])
    monkeypatch.setattr(PassiveSafety, "least", 3.0)
    result = falsify(synthesize(scenario), 200, 0)
    assert result.failure.kind == "drift" and result.failure.margin < 3
    assert str(replay(write_case(tmp_path / "case.json", scenario, result))[0]) == str(result.failure)
    monkeypatch.setattr(PassiveSafety, "least", 0.0)
    assert replay(tmp_path / "case.json")[0] is None


def test_without_the_table_nothing_changes_and_with_it_no_step_does(tiny):
    plain = synthesize(load_scenario(TINY))
    before, after = certificate(plain, "tiny"), certificate(tiny, "tiny")
    assert "drift" not in before and plain.passive is None
    changed = {key for key in after if key not in before or after[key] != before[key]}
    assert changed <= {"drift", "digest", "unsafe_sets"}


def test_what_is_required_is_kept_or_refused_with_the_witness():
    schedule = drifting(load_scenario(TINY), 4 / 12, "abort.required=true")
    assert schedule.passive.clear.all() and schedule.passive.witness() is None
    text = drift_text(schedule.passive.to_dict())
    assert "any time in 0 to 12 s" in text and text.endswith("covers the whole flight.")
    with pytest.raises(SynthesisInfeasible, match="step 1 .*pillar") as error:
        drifting(load_scenario(TINY), 10 / 12, "abort.required=true")
    assert error.value.exit_code == 3 and error.value.shortfall > 0
    orbiting = load_scenario("static").with_assignments(["abort.drift_orbits=0.5"])
    assert orbiting.problem().abort.horizon == pytest.approx(np.pi / 0.0012)


@pytest.fixture(scope="module")
def forger(tmp_path_factory):
    folder = tmp_path_factory.mktemp("passive")
    return Forger(make([COARSE, "abort.drift_s=10.0", "tank.delta_v_m_s=20.0"], folder), folder)


def parts_of(drift):
    """Return all parts of a drift's steps."""
    return [part for parts in drift["steps"] for part in parts or ()]


def sooner(drift):
    for part in parts_of(drift):
        part["facets"] = [[[runs[0][0], runs[0][1]]] for runs in part["facets"]]


def briefer(drift):
    """Every step alike, so that all parts are named."""
    parts = parts_of(drift)
    cut = sum(count for count, _ in parts[0]["facets"][0]) - 2 * drift["parts"]
    for part in parts:
        for runs in part["facets"]:
            while sum(count for count, _ in runs) > cut:
                runs[-1][0] -= 1
                if runs[-1][0] == 0:
                    runs.pop()


def turned(drift):
    part = parts_of(drift)[0]
    part["facets"] = [[[count, (f + 1) % 4] for count, f in runs] for runs in part["facets"]]


def bolder(drift):
    missing = next(k for k, parts in enumerate(drift["steps"]) if not parts)
    drift["steps"][missing] = next(parts for parts in drift["steps"] if parts)


DRIFTS = {
    "narrower": lambda drift: parts_of(drift)[0].update(axes=scaled(parts_of(drift)[0]["axes"], 0.8)),
    "turned": turned,
    "shorter": lambda drift: drift.update(horizon=(9.0).hex()),
    "sooner": sooner,
    "briefer": briefer,
    "bolder": bolder,
}


def test_forged_drifts_are_refused(forger):
    assert forger.judge({}).outcome == "VERIFIED"
    for name, change in DRIFTS.items():
        verdict = forger.forged(lambda data, change=change: change(data["drift"]))
        assert verdict.outcome == "REJECTED" and verdict.claim in ("passive", "guarantee"), name
    more = forger.forged(lambda data: parts_of(data["drift"])[0].update(periods=99))
    assert more.claim == "format"
    schedule, summary = forger.tree("schedule.json"), forger.tree("summary.json")
    schedule["guarantee"]["abort"]["least_m"] *= 1.01
    summary["guarantee"] = schedule["guarantee"]
    verdict = forger.judge({"schedule.json": json.dumps(schedule), "summary.json": json.dumps(summary)})
    assert (verdict.outcome, verdict.claim) == ("REJECTED", "passive")
    assert forger.forged(lambda data: data.pop("drift")).outcome == "REJECTED"


def test_s_spends_no_more_than_its_upkeep_for_ever():
    schedule = synthesize(load_scenario(TINY))
    upkeep, safety = schedule.upkeep, schedule.safety
    assert upkeep.tank is upkeep.lasts is upkeep.per_orbit is None
    loop, K = safety.tracking, safety.tracking.gain
    rng, h = np.random.default_rng(0), 0.05
    A, D = held(safety.problem.system.A - safety.problem.system.B @ K, safety.problem.system.D, h)
    e, w, delta_v, largest = np.zeros((200, 4)), np.zeros((200, 2)), 0.0, 0.0
    for step in range(4000):
        w = rng.normal(size=(200, 2)) if step % 40 == 0 else w
        w[:50] = np.sign(e[:50, 2:]) + 1e-9  # pushes on where it goes
        e = e @ A.T + loop.system.w_max * (w / np.linalg.norm(w, axis=1, keepdims=True)) @ D.T
        delta_v = delta_v + np.abs(e @ K.T).sum(axis=1) * h
        largest = max(largest, float(np.abs(e @ K.T).sum(axis=1).max()))
    assert (delta_v / (4000 * h)).max() <= upkeep.rate and largest <= upkeep.rate * (1 + 1e-9)
    assert (delta_v / (4000 * h)).max() > 0.3 * upkeep.rate


def test_the_tank_lasts_as_long_as_the_bounds_say():
    def lasts(tank):
        return synthesize(load_scenario(TINY).with_assignments([f"tank.delta_v_m_s={tank}"])).upkeep

    plenty, none = lasts(8.0), lasts(0.1)
    scarce = lasts(0.99 * plenty.delta_v)  # enough until T, not until S has settled
    assert plenty.lasts == pytest.approx(plenty.settled + (8 / (1 + CHECKED) - plenty.delta_v) / plenty.rate)
    assert scarce.lasts == 12.0 and none.lasts == 0.0


SLOW = [pytest.param(change, marks=pytest.mark.slow) for change in ({"lasts_s": 2}, {"tank_m_s": 2})]


@pytest.mark.parametrize("change", [{"rate_m_s2": 0.9}, {"rate_m_s2": 0.98}, *SLOW], ids=str)
def test_forged_upkeep_is_refused(forger, change):
    verdict = upkeep_judged(forger, change)
    assert verdict.outcome == "REJECTED" and verdict.claim in ("upkeep", "goal")


def test_more_upkeep_than_is_needed_is_confirmed(forger):
    assert upkeep_judged(forger, {"rate_m_s2": 1.06, "lasts_s": 0.9}).outcome == "VERIFIED"


def upkeep_judged(forger, change):
    """Judge the folder with changed shares of what is claimed of upkeep."""
    honest = forger.tree("schedule.json")["guarantee"]["upkeep"]
    assert honest["lasts_s"] > 12
    files = {}
    for name in ("schedule.json", "summary.json"):
        data = forger.tree(name)
        for key, times in change.items():
            data["guarantee"]["upkeep"][key] *= times
        files[name] = json.dumps(data)
    return forger.judge(files)
