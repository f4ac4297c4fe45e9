"""Run folders forged field by field, hashes and digests right: claims are refused, the rest is listed.

`forging` makes the forgeries. Those in which several files agree on the same lie are written out here.
"""

import json
import random

import numpy as np
import pytest
from scipy.linalg import solve_continuous_are

from polaris.runs.schedule import write_run
from polaris.simulation.baselines import compare
from tests.polaris.conftest import synthesised as bundled
from tests.polaris.forging import (
    CERTIFICATE,
    QUARTER,
    Forger,
    Lie,
    accepted,
    excused,
    make,
    one_at_a_time,
    replaced,
    twice,
)
from tests.sizes import CAMPAIGN

FOLLOWING = {
    "unaware": [],
    "setpoint": [QUARTER, 'experimental.0.reference={kind="setpoint",state=[8.0,6.0,0.0,0.0]}'],
    "shared": [QUARTER, 'experimental.0.reference={kind="shared"}'],
    "in view": [QUARTER, "recoverable.recourse=replan"],
    "sampled": ["feedback={period_s=0.2}", "schedule.min_dwell_steps=2", "schedule.max_switches=3"],
}
"""Variants of the tiny scene."""

FLOWN = "min_distance_m min_distance_mean_m mean_distance_m min_ttc_s min_ttc_free_drift_s delta_v_m_s"


FLOWN = [*FLOWN.split(), "delta_v_max_m_s", "max_thrust_ratio*", "collided_runs"]


NO_CLAIM = (
    # words for readers, how the run came about, and what the simulated runs amount to
    *(f"scenario.toml: {key}" for key in ("title *", "description *", "orbit*", "planner*", "goal.sides *")),
    "scenario.toml: obstacles.*.unbounded *",  # whether its author means it
    "scenario.toml: goal without sides",
    "scenario.toml: simulation* runs",
    "scenario.toml: simulation.runs *",
    *(f"scenario.toml: all of it without {table}" for table in ("orbit", "description", "planner")),
    "scenario.toml: schedule.bound_programs *",
    "schedule.json: rules.beam *",
    "certificate.json: choices*",  # the reader proves anew what comes of them
    "certificate.json: all of it without choices",
    "summary.json: created *",
    "summary.json: model_error.worst*",
    "summary.json: model_error.parts_m_s2* down",  # the bound is compared with their sum
    "summary.json: model_error.satellites_covered_until_s*",
    "summary.json: definitions*",
    "summary.json: versions*",
    *(f"summary.json: synthesis.{key}*" for key in ("planner", "seconds", "share_at_most ", "share_bound")),
    *(f"summary.json: {who}.{what} *" for who in ("safety", "polaris", "experimental") for what in FLOWN),
)
"""Fields that may say anything, within their types: docs/certificate.md says so."""

SAME = (
    "certificate.json: digest *",  # which the forger mends
    "scenario.toml: all of it without simulation",  # where a default says what the file said
    "scenario.toml: simulation* seed",
    "scenario.toml: all of it without feedback",
    "scenario.toml: feedback *",
    "scenario.toml: schedule without *",
    "scenario.toml: all of it without schedule",
    "scenario.toml: tracking without *",
    "scenario.toml: recoverable without *",
    "scenario.toml: all of it without recoverable",
    "scenario.toml: experimental.* without *",
    "scenario.toml: all of it without obstacles",
    "scenario.toml: all of it without faults",
    "scenario.toml: all of it without keep_in",
    "scenario.toml: obstacles.* without *",
    "scenario.toml: keep_in.* without facets",  # 12 is the default
    "scenario.toml: system without *",
    "scenario.toml: goal.*_m *",  # another goal that the reference ends in, too
    "scenario.toml: goal.half_widths.* *",
    "scenario.toml: goal without *",
    "scenario.toml: schedule.max_switches up",  # a rule that is kept, too
    "certificate.json: initial_set.generators *ed",  # the same set
    "certificate.json: facets.*",  # another facet that separates
    "certificate.json: unsafe_sets.*.normals.* *ed",  # another polytope around the set
)
"""Forgeries after which everything said is as true."""

SAFER = (
    "certificate.json: slopes.*",  # any slope from 0 to 1 is sound
    "certificate.json: weights.*",  # any positive weights are
    "certificate.json: unsafe_sets.*.offsets*",
    "scenario.toml: obstacles.*.half_widths_m.* down",
    "scenario.toml: obstacles.*.radius_m down",
    "scenario.toml: obstacles.*.offsets_m.* down",
    "scenario.toml: obstacles.*.normals.*.* up",  # a wall at y = 7, normal -1, moves to y = 14
    "summary.json: synthesis.start_margin down",
)
"""Bounds that are as large as they must be, and scenarios in which there is less to hit."""

EXCUSED = (*NO_CLAIM, *SAME, *SAFER)


@pytest.fixture(scope="module")
def forgers(tmp_path_factory):
    cached = {}

    def forger(kind):
        if kind not in cached:
            folder = tmp_path_factory.mktemp(kind)
            cached[kind] = Forger(make(FOLLOWING[kind], folder), folder)
        return cached[kind]

    return forger


def through(lie, points):
    """A reference at rest in one point after another, as (states, inputs); not a motion of the plant."""
    steps = len(lie.certificate["modes"])
    states = [[*points[min(k, len(points) - 1)], 0.0, 0.0] for k in range(steps + 1)]
    return states, [[0.0, 0.0]] * steps


def test_an_anti_stabilising_gain_is_refused(forgers):
    """It solves the Riccati equation and equals ``R^-1 B' P`` of the P it is compared with."""
    for mode in (0, 1):
        lie = Lie(forgers("unaware"))
        spec = lie.scenario["tracking"] if mode == 0 else lie.scenario["experimental"][0]
        A, B = lie.plant()
        Q, R = np.diag(spec["Q"]), np.diag(spec["R"])
        lie.gain(mode, np.linalg.solve(R, B.T @ -solve_continuous_are(-A, B, Q, R)))
        if mode == 1:
            lie.modes([0] * len(lie.certificate["modes"]))  # it never flies: nothing else fails
        lie.judge({"controllers"})


@pytest.mark.parametrize(
    ("kind", "mode", "points", "claim"),
    [
        (
            "unaware",
            0,
            [[0.0, 0.0], [4.0, 3.0]],
            "format",
        ),  # S through the pillar: its reference is the safe one
        ("unaware", 1, [[0.0, 0.0], [4.0, 3.0], [8.0, 6.0]], "controllers"),
        ("shared", 1, [[0.0, 0.0]], "controllers"),
    ],
)
def test_a_reference_that_is_no_motion_or_not_wanted_is_refused(forgers, kind, mode, points, claim):
    lie = Lie(forgers(kind))
    lie.own(mode, *through(lie, points))
    lie.judge({claim})


def another_start(lie, states, inputs):
    return states + np.array([0.01, 0.0, 0.0, 0.0]), inputs


def too_much_thrust(lie, states, inputs):
    """Out and back within two steps."""
    inputs, states, h = inputs.copy(), states.copy(), lie.schedule["step_s"]
    inputs[0, 0], inputs[1, 0] = 5.0, inputs[0, 0] + inputs[1, 0] - 5.0
    for k in range(len(inputs)):
        p, v, u = states[k, :2], states[k, 2:], inputs[k]
        states[k + 1] = [*(p + h * v + h * h / 2 * u), *(v + h * u)]
    return states, inputs


PLANS = {
    "another start": another_start,
    "another goal": lambda lie, states, inputs: (np.zeros_like(states), np.zeros_like(inputs)),
    "too much thrust": too_much_thrust,
    "cut short": lambda lie, states, inputs: (states[:-1], inputs[:-1]),
}


@pytest.mark.parametrize("what", [*PLANS, "the safe one"])
def test_another_plan_than_an_unaware_one_is_refused(forgers, what):
    lie = Lie(forgers("unaware"))
    lie.modes([0] * len(lie.certificate["modes"]))  # U never flies, so nothing else fails
    if what == "the safe one":  # not given at all: U would follow the safe reference
        for key in ("reference_states", "reference_inputs"):
            del lie.certificate["controllers"][1][key]
    else:
        lie.own(1, *PLANS[what](lie, *lie.follow()))
    lie.judge({"controllers", "format"} if what == "cut short" else {"controllers"})


@pytest.mark.parametrize("state", [[8.0, 5.9, 0.0, 0.0], [8.0, 6.0, 0.0, 1e-3], None])
def test_another_setpoint_is_refused(forgers, state):
    """Or a state and an input that give the same command, but do not keep themselves."""
    lie = Lie(forgers("setpoint"))
    K = np.array(lie.gains["controllers"][1]["gain"])
    states, inputs = lie.follow()
    lie.modes([0] * len(inputs))
    if state is None:
        shifted = states + np.array([0.5, 0.0, 0.0, 0.0])
        lie.own(1, shifted, inputs + (states - shifted)[:-1] @ K.T)
    else:
        A, B = lie.plant()
        rest = np.linalg.solve(A - B @ K, -B @ K @ np.array(state))
        lie.own(1, [rest] * len(states), [K @ (np.array(state) - rest)] * len(inputs))
    lie.judge({"controllers"})


def test_dwell_and_cap_of_the_scenario_hold(forgers):
    """Fewer steps under U than the proven schedule has are as safe: only the rules are broken."""
    honest = Lie(forgers("sampled")).schedule["modes"]
    assert honest[-2:] == [1, 1] and honest[-3] == 1
    for modes, rules in (
        ([*[0] * (len(honest) - 2), 1, 0], {"min_dwell_steps": 2}),
        (honest, {"max_switches": 0}),
        (honest, {"min_dwell_steps": len(honest)}),
    ):
        lie = Lie(forgers("sampled"))
        lie.modes(modes)
        lie.scenario["schedule"] |= rules
        declared = lie.scenario["schedule"]
        lie.schedule["rules"] |= {
            "min_dwell": declared["min_dwell_steps"],
            "max_switches": declared["max_switches"],
        }
        lie.judge({"schedule"})


@pytest.mark.parametrize(
    ("table", "key", "value"),
    [
        ((), "obstacle", [{"kind": "box", "name": "b", "center_m": [2.0, 1.5], "half_widths_m": [1.0, 1.0]}]),
        (("system",), "thrust_max_N", 0.001),
        (("obstacles", 0), "inflation_m", 3.0),
        (("initial_set",), "position_radius_m", 5.0),
        (("feedback",), "delay_s", 1.0),
    ],
)
def test_keys_that_nobody_reads_are_refused(forgers, table, key, value):
    lie = Lie(forgers("sampled"))
    place = lie.scenario
    for part in table:
        place = place[part]
    place[key] = value
    lie.judge({"scenario"})


def all_refused(forger, cases, name, count):
    """Judge a sample that depends on the name only; all of them in a campaign. Returns the excuses used."""
    if not CAMPAIGN and len(cases) > count:
        cases = random.Random(name).sample(cases, count)
    wrong, used = accepted(forger, cases, EXCUSED)
    assert not wrong, f"{len(wrong)} forgeries are verified:\n" + "\n".join(wrong)
    return used


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("guarantee", "horizon"), "infinite"),
        (("guarantee", "until_s"), 1e9),
        (("guarantee", "assumptions"), []),
        (("guarantee", "reason"), "the reference ends at rest, and all unsafe sets are static"),
        (("synthesis", "experimental_share"), 1.0),
        (("synthesis", "planner", "delta_v_m_s"), 0.1),
        (("polaris", "max_thrust_ratio_safety"), 2.0),
        (("polaris", "collided_runs"), 1),
        (("safety", "controller"), "hasty"),
        (("title",), "Another scene"),
    ],
)
def test_a_summary_that_claims_more_is_refused(forgers, path, value):
    forger = forgers("unaware")
    files = {"summary.json": json.dumps(replaced(forger.tree("summary.json"), path, value))}
    verdict = forger.judge(files)
    assert verdict.outcome == "REJECTED" and verdict.claim in ("summary", "margins"), verdict.text()
    if path == ("guarantee", "reason"):  # the schedule agrees
        lie = Lie(forger)
        lie.schedule["guarantee"]["reason"] = lie.summary["guarantee"]["reason"] = value
        lie.judge({"end"})


def test_fields_forged_one_at_a_time_are_refused(forgers):
    forger = forgers("unaware")
    claims = [case for case in one_at_a_time(forger, 0, 1, 0.5) if not excused(case[0], EXCUSED)]
    assert len(claims) >= 500
    all_refused(forger, claims, 0, 60)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [*FOLLOWING, "dynamic", "robot"])
def test_every_field_forged_is_refused(kind, forgers, tmp_path):
    """Excuses are used, too: a list that excuses what is refused would hide nothing, and say less."""
    if kind in FOLLOWING:
        used = all_refused(forgers(kind), list(one_at_a_time(forgers(kind), 1, 2, 0.5)), kind, 40)
        assert not CAMPAIGN or kind != "unaware" or "certificate.json: facets.*" in used
        return
    scenario, schedule = bundled(kind)
    run = write_run(tmp_path / kind, scenario, schedule, compare(schedule, 2, 0)).path
    forger = Forger(run, tmp_path)
    claims = [case for case in one_at_a_time(forger, 2, 1, 0.5) if not excused(case[0], EXCUSED)]
    all_refused(forger, claims, kind, 20)


@pytest.mark.parametrize("name", [CERTIFICATE, "schedule.json", "gains.json", "summary.json"])
def test_keys_that_stand_twice_are_refused(forgers, name):
    cases = list(twice(forgers("setpoint"), name))
    assert len(cases) >= 15
    wrong, _ = accepted(forgers("setpoint"), random.Random(0).sample(cases, 8), ())
    assert not wrong
