"""Errors of navigation and thrusters (Proposition 5), the chaser's size: in proofs, flown at their worst."""

import json
import pydoc
import re
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from docs.generate import source_docs
from polaris import Craft, Monitor, Stages, falsify, get_safety, load_scenario, synthesize
from polaris.certificate.files.demands import CHECKED, listed
from polaris.model.errors import PolarisError, ScenarioError, SynthesisInfeasible
from polaris.model.scene.keep_in import KeepInCone, KeepInPolytope
from polaris.model.scene.obstacles import BallObstacle, BoxObstacle, PolytopeObstacle
from polaris.model.thrusters import Thrusters
from polaris.rta.online.estimate import BoxFilter, BoxMotion
from polaris.runs.schedule import fly_schedule
from polaris.scenario.reading import write_toml
from polaris.scenario.tables.schedule import ScenarioModel
from polaris.synthesis.sources.craft import SOURCES, craft_loop
from reach import discretize
from tests.kept import kept
from tests.polaris.closed_loops import attack, attack_monitor
from tests.polaris.corruptions import scaled
from tests.polaris.forging import CERTIFICATE, COARSE, Forger, make
from tests.polaris.random_scenarios import random_scenario
from tests.polaris.synthesis.safety.test_closed_loops import PRINTED, judge, monitored
from tests.polaris.tiny import TINY
from tests.sizes import fewer

FEW = (5016, 5024, 5034)
"""Random scenes that are proved with errors, too; among them clipped laws and sampled feedback."""

POLYTOPE = "recoverable.kind=polytope"
ERRORS = (
    "navigation.state_error=[0.01, 0.01, 0.002, 0.002]",
    "chaser.radius_m=0.05",
    "thrusters.magnitude_error=0.01",
    "thrusters.mass_error=0.005",
    "tracking.thrust_share=0.9",
)


def exact(seed):
    """A random scene without errors."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "scene.toml"
        path.write_text(random_scenario(seed), encoding="utf-8")
        return load_scenario(path, [POLYTOPE])


def tables(scenario, seed, scale=0.1):
    """Assignments of random errors of navigation and thrusters, and a size, to a random scene."""
    rng, widths, d = np.random.default_rng(seed), scenario.initial_set().half_widths, scenario.system().d
    error = widths * rng.uniform(0, scale, len(widths))
    size = f"chaser.radius_m={widths.max() * rng.uniform(0, scale):.6g}"
    if scenario.system().mean_motion is None:
        navigation = [f"navigation.state_error={error.tolist()}"]
    else:
        parts = ("position_error_m", error[:d].tolist()), ("velocity_error_m_s", error[d:].tolist())
        navigation = [f"navigation.{name}={part}" for name, part in parts]
    thrusters = [f"thrusters.{key}={rng.uniform(0, 0.06):.3g}" for key in ("magnitude_error", "mass_error")]
    if scenario.problem().period is not None:
        impulse = scenario.problem().period * scenario.system().u_max.min()
        thrusters.append(f"thrusters.impulse_bit_N_s={float(impulse * rng.uniform(0, 0.03))}")
    if scenario.system().mean_motion is not None:
        thrusters.append(f"thrusters.misalignment_deg={rng.uniform(0, 2):.3g}")
    return [*navigation, size, *thrusters, f"tracking.thrust_share={rng.uniform(0.5, 1):.3g}"]


@cache
def made(seed, *more):
    """(scenario, schedule) of a random scene with errors, if it is proved."""
    scenario = exact(seed)
    scenario = scenario.with_assignments([*tables(scenario, seed), *more])
    try:
        return kept("-".join(["errors", str(seed), *more]), lambda: (scenario, synthesize(scenario)))
    except PolarisError:
        return None


def test_a_few_proofs_hold_with_errors_at_their_worst():
    tight = []
    for seed in FEW[:2]:
        _, schedule = made(seed, *[PRINTED] * (seed != FEW[0]))  # U in view in one of them
        worst = attack(schedule, 40, seed)
        judge(seed, worst)
        tight.append(worst.tight)
        assert falsify(schedule, 100, seed).failure is None
    assert np.median(tight) > 0.4


def test_errors_left_out_of_the_proof_break_it():
    """Attacks refute a schedule that was made without the errors."""
    over = 0.0
    for seed in FEW:
        if over <= 1e-3:
            schedule, wrong = synthesize(exact(seed)), 20 * made(seed, PRINTED)[0].system().navigation
            object.__setattr__(schedule.safety.problem.system, "estimate_error", wrong)
            over = max(over, attack(schedule, 60, seed).over)
    assert over > 1e-3


def test_a_planner_whose_solver_has_got_stuck_starts_another():
    """Strict pivoting, once asked for, stays with a solver; with this scene it found no way out."""
    scenario = exact(7013)
    scenario = scenario.with_assignments(tables(scenario, 7013, 0.05))
    assert get_safety(scenario.problem()).start_margin.inside


def test_an_error_that_cannot_be_met_is_named_with_one_that_can():
    far = load_scenario(TINY, ["navigation.state_error=[50.0, 0, 0, 0]", "chaser.radius_m=0.001"])
    with pytest.raises(SynthesisInfeasible, match="navigation"):
        synthesize(far)
    with pytest.raises(SynthesisInfeasible) as error:
        fly_schedule(far, Stages())
    words = r"; or declare navigation.state_error = \[([\d.]+), 0, 0, 0\] \(not \[50.0, 0.0, 0.0, 0.0\]\)"
    size = re.search(words, str(error.value))
    assert size is not None and "radius_m" not in str(error.value)
    assert get_safety(far.set("navigation.state_error", [float(size[1]), 0, 0, 0]).problem())
    with pytest.raises(SynthesisInfeasible):
        get_safety(far.set("navigation.state_error", [1.3 * float(size[1]), 0, 0, 0]).problem())


@pytest.mark.slow
def test_less_feedback_is_tried_where_errors_of_thrusters_leave_no_safe_reference():
    scenario = load_scenario("keep_out").with_assignments(
        ["thrusters.misalignment_deg=22", "horizon.step_s=60"]
    )
    with pytest.raises(SynthesisInfeasible, match="cross-track thrust"):
        get_safety(scenario.set("tracking.thrust_share", 0.5).problem())
    safety = get_safety(scenario.problem())
    assert safety.problem.thrust_share == 0.35 and safety.start_margin.inside


def test_in_hills_frame_errors_have_units():
    scenario = load_scenario("static").with_assignments(
        ["navigation.position_error_m=[1, 2, 3]", "navigation.velocity_error_m_s=0.5"]
    )
    assert scenario.system().navigation.tolist() == [1, 2, 3, 0.5, 0.5, 0.5]
    with pytest.raises(ScenarioError, match="position_error_m"):
        load_scenario("static").with_assignments(["navigation.state_error=[0.1, 0, 0, 0, 0, 0]"])
    with pytest.raises(ScenarioError, match="full thrust makes in a period, 0.4 N s"):
        scenario.with_assignments(["thrusters.impulse_bit_N_s=0.41"])


def test_errors_of_thrusters_cover_every_way_to_make_them():
    rng, bounds = np.random.default_rng(1), (0.05, np.deg2rad(4.0), 0.03)
    bit, period = 0.005, 2.0
    rounding = bit / (2 * period)
    errors, largest = Thrusters.from_errors(*bounds, rounding, 3), 0.0
    for _ in range(4000):
        u = rng.normal(size=3) * [1.0, 0.3, 0.1]
        rounded = np.round(u * period / bit) * bit / period
        way = np.cross(rounded, rng.normal(size=3))
        aside = np.sin(bounds[1]) * np.linalg.norm(rounded) * way / np.linalg.norm(way)
        tilted = np.cos(bounds[1]) * rounded + aside
        size, mass = 1 + bounds[0] * rng.choice([-1, 1], 3), 1 + bounds[2] * rng.choice([-1, 1])
        share = np.abs(size * tilted / mass - u) / errors.error(u)
        assert np.all(share <= 1)
        largest = max(largest, share.max())
    assert largest > 0.9


def test_a_box_of_states_holds_whatever_thrusters_make_of_a_command():
    A, B = np.eye(4, k=2), np.eye(4)[:, 2:]
    system = Craft(A, B, B, [1.0, 1.2], 0.0, thrusters=Thrusters(0.1, 0.05, 0.02))
    rng, command, Bd = np.random.default_rng(0), 0.5 * system.u_max, discretize(A, B, 2.0)[1]
    for bounds in ([-command, command], None):
        box = BoxFilter(BoxMotion(system, 0.5, 2.0), np.zeros(4), np.zeros(4))
        box.note_commands(None if bounds is None else np.array(bounds), True)
        reach, u = box.propagated(2.0), rng.choice([-1, 1], (200, 2)) * (command if bounds else system.u_max)
        x = (u + np.sign(u) * system.thrusters.error(u)) @ Bd.T
        assert np.all(x <= reach[:4]) and np.all(-x <= reach[4:]) and np.any(x > np.abs(u) @ Bd.T)


@cache
def printed(seed, errors=True):
    """Schedule of a random scene, with errors or without, that leaves a monitor something to do."""
    scenario = exact(seed)
    assignments = [PRINTED, *(tables(scenario, seed) if errors else [])]
    return kept(f"errors-printed-{seed}-{errors}", lambda: synthesize(scenario.with_assignments(assignments)))


def test_a_monitor_holds_with_errors_at_their_worst():
    monitor = monitored(5001, printed(5001))
    worst, under = attack_monitor(monitor, 40, 5001)
    judge(5001, worst)
    assert under > 0.1
    judge(5001, attack_monitor(Monitor(monitor.grid.with_feedback_bound(), monitor.trust), 40, 5001)[0])


def test_errors_that_a_monitor_does_not_know_of_break_it():
    monitor, true_system = monitored(5001, printed(5001, False)), printed(5001).safety.problem.system
    system = monitor.grid.system
    ours = system.estimate_error, system.thrusters
    object.__setattr__(system, "estimate_error", true_system.navigation)
    object.__setattr__(system, "thrusters", true_system.thrusters)
    worst, _ = attack_monitor(monitor, 80, 5001)
    object.__setattr__(system, "estimate_error", ours[0])
    object.__setattr__(system, "thrusters", ours[1])
    assert worst.thrust < -5e-4


@pytest.mark.slow
def test_many_monitors_hold_with_errors_at_their_worst():
    monitors = 0
    seeds = range(5000, fewer(5060, 5010))
    for seed in seeds:
        try:
            schedule = printed(seed)
        except PolarisError:
            continue
        for number in range(3 if len(schedule.controllers) > 1 else 0):
            if (monitor := monitored(seed + 1000 * number, schedule)) is not None:
                judge(seed, attack_monitor(monitor, 120, seed)[0])
                monitors += 1
    assert monitors >= fewer(70, 0.8 * len(seeds))


def test_a_grown_set_holds_every_place_within_the_radius():
    rng, radius = np.random.default_rng(0), 0.7
    axis, turn = np.array([1.0, 2.0, 0.5]), np.linalg.qr(rng.normal(size=(3, 3)))[0]
    sets = [
        BoxObstacle("box", [0, 0, 0], [1, 2, 3]),
        BallObstacle("ball", [0, 0, 0], 2.0),
        PolytopeObstacle("polytope", np.vstack([turn, -turn]), np.full(6, 2.0)),
        KeepInPolytope("clearance", np.vstack([np.eye(3), -np.eye(3)]), np.full(6, 4.0)),
        KeepInCone("cone", [0, 0, 0], axis, 0.4, length=9.0),
    ]
    p = rng.uniform(-8, 8, (4000, 3))
    for item in sets:
        before, after = item.signed_distance(0.0, p), item.inflated(radius).signed_distance(0.0, p)
        assert np.all(after <= before - radius + 1e-9), item.name
        assert np.all((after < 0)[before < radius]) and item.inflated(radius).chaser_radius == radius
        near = np.abs(after) < 0.2
        assert np.median((before - radius - after)[near]) < 0.02, item.name  # facets fit exactly


def test_the_docs_say_where_every_error_enters():
    text = source_docs.PAGE.read_text(encoding="utf-8")
    table = source_docs.table()
    assert table in text, "run: python -m docs.generate.source_docs"
    assert all(pydoc.locate(place) is not None for place in source_docs.HEAD.values() if place)
    assert {row.table.split(".")[0] for row in source_docs.ROWS} <= set(ScenarioModel.model_fields)
    assert all(f"`{source.__name__}`" in table for source in SOURCES)


FORMS = {
    *(
        "navigation.state_error",
        "navigation.phases.state_error",
        "navigation.measurement.initial.state_error",
    ),
    *("navigation.measurement.matrix", "navigation.measurement.error", "thrusters.directions"),
    *("thrusters.thrust_max_N", "thrusters.allocation", "thrusters.fall_s"),
}
"""Keys that declare a source of the table in another form."""


def test_the_table_of_sources_names_every_key_of_an_error():
    """A new key needs a row in `docs/generate/source_docs.py`, or a place in `FORMS` if a row covers it."""
    texts = [text for row in source_docs.ROWS for text in (row.table, *row.example, *row.beside)]
    words = set(re.findall(r"\w+", " ".join(texts)))
    keys = [key for tables in CHECKED.values() for key in listed(tables)]
    errors = {key for key in keys if key.split(".")[0] in ("navigation", "thrusters", "timing", "faults")}
    missing = {key for key in errors if key.split(".")[-1] not in words}
    assert missing == FORMS, sorted(missing ^ FORMS)


@pytest.mark.parametrize("row", source_docs.ROWS, ids=lambda row: row.name)
def test_the_checker_has_as_many_states_as_the_loop(row):
    declared = source_docs.Declared((*row.beside, *row.example))
    system, h = declared.problem.system, declared.problem.period
    assert declared.craft.F.nrows() == craft_loop(system, h).N


def test_forged_errors_are_refused(tmp_path):
    forger = Forger(make([COARSE.replace("0.5", "0.25"), *ERRORS], tmp_path), tmp_path)
    assert forger.judge({}).outcome == "VERIFIED"
    names, data = forger.honest["assumptions"], forger.tree(CERTIFICATE)
    system, feedback_bound = data["system"], data["feedback_bound"]
    less_error = {"system": system | {"estimate_error": [(0.001).hex()] * 4}}
    words = [w.replace("[0.01, 0.01, 0.002, 0.002]", "[0.001, 0.001, 0.001, 0.001]") for w in names]
    smaller = [w.replace("within 0.05 m", "within 0.04 m") for w in names]
    ideal = {"system": {k: v for k, v in system.items() if k != "thrusters"}}
    for forged, claims in (
        (less_error, {"assumptions"}),
        ({"system": {k: v for k, v in system.items() if k != "estimate_error"}}, {"assumptions"}),
        ({"chaser_radius": (0.01).hex()}, {"assumptions"}),
        (less_error | {"assumptions": words}, {"system"}),
        (ideal | {"assumptions": [w for w in names if not w.startswith("thrusters")]}, {"system"}),
        ({"chaser_radius": (0.04).hex(), "assumptions": smaller}, {"unsafe_sets"}),
        ({"feedback_bound": scaled(feedback_bound, 20)}, {"goal", "margins"}),
        ({"feedback_bound": scaled(feedback_bound, 0.5)}, {"recoverable", "margins"}),
        (
            {"feedback_bound": [*feedback_bound[:-1], [(1e-6).hex()] * len(feedback_bound[0])]},
            {"recoverable", "margins"},
        ),
        ({"feedback_bound": feedback_bound[::-1]}, {"format"}),
    ):
        verdict = forger.judge({CERTIFICATE: json.dumps(data | forged)})
        assert verdict.outcome == "REJECTED" and verdict.claim in claims, verdict.text()
    scenario, larger = (
        forger.tree("scenario.toml"),
        [w.replace("within 0.05 m", "within 0.06 m") for w in names],
    )
    scenario["chaser"]["radius_m"], both = 0.06, {"chaser_radius": (0.06).hex(), "assumptions": larger}
    files = {CERTIFICATE: json.dumps(data | both), "scenario.toml": write_toml(scenario)}
    assert forger.judge(files).claim == "unsafe_sets"  # sets that are not inflated by as much
    scenario = forger.tree("scenario.toml")
    scenario["navigation"]["state_error"] = [0.03] * 4
    assert forger.judge({"scenario.toml": write_toml(scenario)}).outcome == "REJECTED"
