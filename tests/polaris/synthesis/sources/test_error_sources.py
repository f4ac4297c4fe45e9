"""Errors of navigation and thrusters (Proposition 5), the chaser's size: in proofs, flown at their worst."""

import json
import pydoc
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import flint
import numpy as np
import pytest

from docs.generate import source_docs
from polaris.certificate.checker import verify_document
from polaris.certificate.claims.argument import Argument
from polaris.certificate.files.artefacts import FileClaims
from polaris.certificate.files.demands import CHECKED, listed
from polaris.certificate.files.document import Document
from polaris.certificate.kernel.balls import PRECISION
from polaris.certificate.kernel.verdict import Record
from polaris.model.errors import PolarisError, ScenarioError, SynthesisInfeasible
from polaris.model.scene.keep_in import KeepInCone, KeepInPolytope
from polaris.model.scene.obstacles import BallObstacle, BoxObstacle, PolytopeObstacle
from polaris.model.thrusters import Thrusters
from polaris.rta.arena import compare_methods
from polaris.rta.decision_grid import DecisionGrid
from polaris.rta.methods.monitor import Monitor
from polaris.rta.online.estimate import BoxFilter, BoxMotion
from polaris.runs.certificate import certificate
from polaris.runs.schedule import fly_schedule
from polaris.runs.stages import Stages
from polaris.scenario.reading import write_toml
from polaris.scenario.scenario import load_scenario
from polaris.scenario.tables.schedule import ScenarioModel
from polaris.simulation.falsification.search import falsify
from polaris.synthesis.safety.carried_rows import error_tube
from polaris.synthesis.safety.feedforward import Feedforward
from polaris.synthesis.safety.get_safety import get_safety
from polaris.synthesis.schedule.synthesize import synthesize
from polaris.synthesis.sources.craft import SOURCES, craft_loop
from polaris.synthesis.tracker.affine_law import LEVELS, AffineLaw
from reach.numerics.linear import discretize
from reach.sets.zonotope import Zonotope
from tests.kept import kept
from tests.polaris.closed_loops import attack, attack_monitor
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
        given = [f"navigation.state_error={error.tolist()}"]
    else:
        parts = ("position_error_m", error[:d].tolist()), ("velocity_error_m_s", error[d:].tolist())
        given = [f"navigation.{name}={part}" for name, part in parts]
    thrusters = [f"thrusters.{key}={rng.uniform(0, 0.06):.3g}" for key in ("magnitude_error", "mass_error")]
    if scenario.problem().period is not None:
        impulse = scenario.problem().period * scenario.system().u_max.min()
        thrusters.append(f"thrusters.impulse_bit_N_s={float(impulse * rng.uniform(0, 0.03))}")
    if scenario.system().mean_motion is not None:
        thrusters.append(f"thrusters.misalignment_deg={rng.uniform(0, 2):.3g}")
    return [*given, size, *thrusters, f"tracking.thrust_share={rng.uniform(0.5, 1):.3g}"]


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


@pytest.mark.slow
def test_many_proofs_hold_with_errors_at_their_worst():
    scenes, tight = 0, []
    seeds = range(5000, fewer(5080, 5027))
    for seed in seeds:
        if (known := made(seed)) is None:
            continue
        worst = attack(known[1], 200, seed)
        judge(seed, worst)
        scenes, tight = scenes + 1, [*tight, worst.tight]
    assert scenes >= fewer(50, len(seeds) // 2) and np.median(tight) > 0.6


def test_the_share_of_an_error_is_what_its_worst_signs_reach():
    """Along a row, for ever: the bound is the sum over the periods of the response to constant signs."""
    scenario = load_scenario(TINY).with_assignments(["system.disturbance_max=0.0", ERRORS[0]])
    tracking = synthesize(scenario).safety.tracking
    system, flow = tracking.system, tracking.flow
    rows = np.vstack([system.position, tracking.gain])
    bound = tracking.disturbance(rows)[-1]
    kick = flow.input_map(system.B) @ tracking.gain
    reached, carried = np.zeros(len(rows)), rows
    for _ in range(tracking.settling):
        reached += np.abs(carried @ kick) @ system.navigation
        carried = carried @ flow.phi
    assert np.all(reached <= bound) and np.all((reached / bound).reshape(2, 2).T > [0.9, 0.6])


def test_without_errors_everything_is_as_without_the_tables():
    plain = load_scenario(TINY)
    zero = plain.with_assignments(["navigation.state_error=[0.0, 0.0, 0.0, 0.0]", "chaser.radius_m=0.0"])
    zero = zero.with_assignments(["thrusters.magnitude_error=0.0", "thrusters.mass_error=0.0"])
    assert certificate(synthesize(plain), "tiny") == certificate(synthesize(zero), "tiny")


def test_a_planner_whose_solver_has_got_stuck_starts_another():
    """Strict pivoting, once asked for, stays with a solver; with this scene it found no way out."""
    scenario = exact(7013)
    scenario = scenario.with_assignments(tables(scenario, 7013, 0.05))
    assert get_safety(scenario.problem()).start_margin.inside


def test_a_need_grows_with_the_error_and_what_cannot_be_met_is_named():
    scenario = load_scenario(TINY)
    tightenings = []
    for error in (0.0, 0.001, 0.01):
        safety = synthesize(scenario.with_assignments([f"navigation.state_error=[{error}, 0, 0, 0]"])).safety
        tightenings.append(error_tube(safety.tracking, safety.start, safety.tracking.gain).tightening[-1, 0])
    assert tightenings[0] < tightenings[1] < tightenings[2]
    far = scenario.with_assignments(["navigation.state_error=[50.0, 0, 0, 0]", "chaser.radius_m=0.001"])
    with pytest.raises(SynthesisInfeasible, match="navigation"):
        synthesize(far)
    with pytest.raises(SynthesisInfeasible, match=r"; or declare navigation.state_error = \[.*, 0") as error:
        fly_schedule(far, Stages())
    size = re.search(r"state_error = \[([\d.]+), 0, 0, 0\] \(not \[50.0, 0.0, 0.0, 0.0\]\)", str(error.value))
    assert size is not None and "radius_m" not in str(error.value)
    enough = [
        f"navigation.state_error=[{size[1]}, 0, 0, 0]",
        f"navigation.state_error=[{1.3 * float(size[1])}, 0, 0, 0]",
    ]
    assert get_safety(far.with_assignments(enough[:1]).problem())
    with pytest.raises(SynthesisInfeasible):
        get_safety(far.with_assignments(enough[1:]).problem())


@pytest.mark.parametrize(
    ("assignment", "field"),
    [
        ("navigation.state_error=[0.1]", "navigation.state_error"),
        ("navigation.state_error=[-0.1, 0.0, 0.0, 0.0]", "navigation.state_error"),
        ("navigation.position_error_m=0.1", "navigation.position_error_m"),
        ("chaser.radius_m=-1.0", "chaser.radius_m"),
        ("thrusters.magnitude_error=0.5", "thrusters.magnitude_error"),
        ("thrusters.misalignment_deg=1.0", "thrusters.misalignment_deg"),
        ("thrusters.impulse_bit_N_s=0.2", "thrusters.impulse_bit_N_s"),
        ("tracking.thrust_share=0.0", "tracking.thrust_share"),
    ],
)
def test_bad_tables_are_refused_by_name(assignment, field):
    with pytest.raises(ScenarioError) as error:
        load_scenario(TINY).with_assignments([assignment])
    assert error.value.field.startswith(field)


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
    """Any magnitude, direction and mass within the bounds, and an impulse rounded to the bit."""
    rng, bounds = np.random.default_rng(1), (0.05, np.deg2rad(4.0), 0.03)
    bit, period = 0.005, 2.0
    rounding = bit / (2 * period)
    errors, largest = Thrusters.from_errors(*bounds, rounding, 3), 0.0
    for _ in range(4000):
        u = rng.normal(size=3) * [1.0, 0.3, 0.1]
        rounded = np.round(u * period / bit) * bit / period
        way = np.cross(rounded, rng.normal(size=3))
        aside = np.sin(bounds[1]) * np.linalg.norm(rounded) * way / np.linalg.norm(way)
        turned = np.cos(bounds[1]) * rounded + aside
        size, mass = 1 + bounds[0] * rng.choice([-1, 1], 3), 1 + bounds[2] * rng.choice([-1, 1])
        share = np.abs(size * turned / mass - u) / errors.error(u)
        assert np.all(share <= 1)
        largest = max(largest, share.max())
    assert largest > 0.9


@cache
def magnified():
    """The tiny scene with thrusters that are off by a tenth."""
    return synthesize(load_scenario(TINY).with_assignments(["thrusters.magnitude_error=0.1"]))


def test_the_errors_of_a_step_follow_what_is_commanded_in_it():
    schedule = magnified()
    law, start = schedule.controllers[1], schedule.safety.start
    tube = law.propagate(start, 0)
    assert all(np.all(np.frombuffer(kept) <= law.system.u_max) for kept, _ in law._levels)
    levels, ends = list(law._levels.values()), [replace(law, most=1e-9 * law.system.u_max), law]
    least, widest = (each.disturbance[-1].half_widths for each in ends)
    sizes = [each.disturbance[-1].half_widths for each in levels]
    assert len(levels) > 1 and all(np.all((least <= size) & (size <= widest)) for size in sizes)
    assert np.ptp(sizes, axis=0).min() > 0
    assert any(np.array_equal(each._flown(start, 0)[0].end.G, tube.end.G) for each in levels)


def test_levels_that_are_foreseen_are_those_that_are_found_from_the_least_one(monkeypatch):
    schedule = magnified()
    law, start, u_max = schedule.controllers[1], schedule.safety.start, schedule.safety.problem.system.u_max
    foreseen = law.foreseen(start - law.whole_offset(0)[0], 0)
    tube, _ = law.propagate(start, 0), law._levels.clear()
    monkeypatch.setattr(AffineLaw, "foreseen", lambda law, d, k: LEVELS[0] * law.system.u_max)
    climbed = law.propagate(start, 0)
    assert np.any(foreseen > LEVELS[0] * u_max)
    assert np.array_equal(climbed.end.G, tube.end.G) and np.array_equal(climbed.intersample, tube.intersample)


def test_s_has_the_errors_of_all_that_it_may_command_where_its_tube_is_wide():
    """That a wide tube's bound on commands exceeds the limits refuses U; S flies on, with errors as large."""
    schedule = magnified()
    law, start = schedule.safety.controller, schedule.safety.start
    wide = Zonotope(start.c, 100 * np.eye(len(start.c)))
    widest, _ = law._like(law.system.u_max, None)._flown(wide, 0)
    assert widest.refused
    assert np.array_equal(law.propagate(wide, 0).nodes.half_widths, widest.nodes.half_widths)


def test_a_profile_allows_for_the_errors_of_its_own_commands():
    """Commands at the profile, all errors at their worst signs: the response keeps to it, from rest too."""
    scenario = load_scenario(TINY).with_assignments([ERRORS[0], *ERRORS[2:4]])
    schedule = synthesize(scenario)
    assert verify_document(certificate(schedule, "tiny")).outcome == "VERIFIED"
    safety = schedule.safety
    tracking, flow, gain = safety.tracking, safety.tracking.flow, safety.tracking.gain
    feedback_bound, part = tracking.feedback_bound, tracking.system.thrusters.part
    assert np.all(np.diff(feedback_bound, axis=0) <= 0) and np.all(feedback_bound[-1] < tracking.system.u_max)
    kick = np.abs(gain @ tracking.transitions @ flow.input_map(tracking.system.B))
    reached = np.zeros(len(gain))
    for lag in range(tracking.settling):
        errors = [part(feedback_bound[i]) for i in range(lag)]
        reached = np.sum([kick[lag - 1 - i] @ e for i, e in enumerate(errors)], axis=0)
        assert np.all(reached + tracking.noise <= feedback_bound[lag])
    tightening = tracking.responses(tracking.commands[: len(gain)], feedback_bound)[-1] + tracking.noise
    assert np.all(reached < tightening) and np.all(tightening <= feedback_bound[-1])


@pytest.mark.slow
def test_a_certificate_with_errors_holds_far_beyond_the_memory_of_the_loop():
    given = ["feedback.period_s=2.0", "thrusters.impulse_bit_N_s=0.005"]
    given += ["thrusters.magnitude_error=0.05", "thrusters.misalignment_deg=2.0", "thrusters.mass_error=0.03"]
    schedule = synthesize(load_scenario("static").with_assignments([*given, "tracking.thrust_share=0.5"]))
    assert schedule.share() >= 0.8 and schedule.safety.end.horizon == "infinite"
    document, record = Document(json.loads(json.dumps(certificate(schedule, "static")))), Record()
    with flint.ctx.workprec(PRECISION):
        Argument(document, record, FileClaims(schedule.safety.start_margin.value)).run()
    assert ("guarantee", "proved") in record.checked


def test_what_the_reference_commands_is_booked_where_it_acts():
    scenario = load_scenario(TINY).with_assignments(ERRORS[2:4])
    safety = synthesize(scenario).safety
    clearance, nu = safety.clearance, np.abs(safety.reference.nu)
    rows = safety.tracking.commands[: nu.shape[1]]
    caused, sent = clearance.scheduled(rows), clearance._scheduled.commanded
    assert np.all(sent >= nu + caused.max(axis=1) - 1e-12) and np.all(sent.max(axis=0) < 1.5 * nu.max(axis=0))
    tail = sent[clearance.planned :]
    assert np.all(np.diff(tail, axis=0) <= 0) and np.all(tail[len(tail) // 2 :] == sent[-1])
    assert np.all(clearance.scheduled(safety.tracking.system.position) > 0)


NEARLY = (
    *("thrusters.misalignment_deg=20", "tracking.thrust_share=0.5", "recoverable.recourse=none"),
    *("horizon.step_s=90", "feedback.period_s=6"),
)
"""Errors of thrusters that nearly feed on themselves: what bounds them takes long to be found."""


def nearly():
    """Return the schedule of the static scene with such errors."""
    return kept("nearly", lambda: synthesize(load_scenario("static").with_assignments(NEARLY)))


@pytest.mark.slow
def test_errors_that_nearly_feed_on_themselves_are_bounded():
    schedule = nearly()
    assert schedule.guarantee == "proved" and schedule.share() > 0
    safety, bounded = schedule.safety, []
    for more in (0.1, 1.0, 1.1, 1.3, 3.0):
        system = safety.tracking.system
        system = replace(system, thrusters=replace(system.thrusters, across=more * system.thrusters.across))
        tracking = replace(safety.tracking, system=system)
        scheduled = Feedforward(tracking, safety.reference, safety.clearance.planned)
        caused = scheduled.response(tracking.commands[: system.m]).max(axis=1)
        bounded.append(np.all(scheduled.commanded >= np.abs(safety.reference.nu) + caused))
        assert bounded[-1] or np.any(caused > system.u_max), "neither a bound, nor are thrusters exhausted"
    assert bounded[1] and not bounded[-1]


@pytest.mark.slow
def test_errors_that_nearly_feed_on_themselves_are_bounded_by_the_checker_too():
    assert verify_document(certificate(nearly(), "static")).outcome == "VERIFIED"


@cache
def printed(seed, errors=True):
    """Schedule of a random scene, with errors or without, that leaves a monitor something to do."""
    scenario = exact(seed)
    given = [PRINTED, *(tables(scenario, seed) if errors else [])]
    return kept(f"errors-printed-{seed}-{errors}", lambda: synthesize(scenario.with_assignments(given)))


@pytest.mark.parametrize("seed", [5001, pytest.param(5024, marks=pytest.mark.slow)])
def test_a_few_monitors_hold_with_errors_at_their_worst(seed):
    monitor = monitored(seed, printed(seed))
    worst, under = attack_monitor(monitor, 40, seed)
    judge(seed, worst)
    assert under > 0.1
    judge(seed, attack_monitor(Monitor(monitor.grid.with_feedback_bound(), monitor.trust), 40, seed)[0])


@pytest.mark.slow
def test_delays_and_jitter_are_among_the_errors_of_a_monitor():
    scenario = exact(5001)
    h = scenario.problem().period
    late = [f"timing.delay_s={h}", "timing.missed_periods=1", f"timing.jitter_s={h / 500}"]
    schedule = synthesize(scenario.with_assignments([PRINTED, *tables(scenario, 5001), *late]))
    system = schedule.safety.problem.system
    assert np.all(system.navigation > printed(5001).safety.problem.system.navigation)
    assert DecisionGrid.from_schedule(schedule).half_widths.tolist() == system.navigation.tolist()
    assert (
        DecisionGrid.from_schedule(schedule, half_widths=0.0).half_widths.tolist()
        == system.state_offset.tolist()
    )
    assert np.any(system.state_offset)
    worst, under = attack_monitor(Monitor(DecisionGrid.from_schedule(schedule)), 40, 5001)
    judge(5001, worst)
    assert under > 0.1


def test_errors_that_a_monitor_does_not_know_of_break_it():
    monitor, known = monitored(5001, printed(5001, False)), printed(5001).safety.problem.system
    system = monitor.grid.system
    ours = system.estimate_error, system.thrusters
    object.__setattr__(system, "estimate_error", known.navigation)
    object.__setattr__(system, "thrusters", known.thrusters)
    worst, _ = attack_monitor(monitor, 80, 5001)
    object.__setattr__(system, "estimate_error", ours[0])
    object.__setattr__(system, "thrusters", ours[1])
    assert worst.thrust < -5e-4


@pytest.mark.slow
def test_many_monitors_hold_with_errors_at_their_worst():
    monitors = 0
    seeds = range(5000, fewer(5060, 5020))
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


def test_run_time_methods_fly_with_errors_and_none_that_is_proven_collides():
    mild = ["navigation.state_error=[0.004, 0.004, 0.001, 0.001]", "thrusters.magnitude_error=0.01"]
    schedule = synthesize(load_scenario(TINY).with_assignments([*mild, "system.input_max=2.0"]))
    comparison = compare_methods(DecisionGrid.from_schedule(schedule, latency=1 / 3, period=1 / 3), 4)
    assert not comparison.refused and comparison.grid.half_widths.tolist() == [0.004, 0.004, 0.001, 0.001]
    for one in comparison.results.values():
        assert one.claim.kind == "none" or not one.metrics.collided.any(), one.name
    assert comparison.results["experimental"].metrics.collided.all()
    assert comparison.results["monitor_declared"].metrics.experimental_share.min() > 0.1


def test_a_box_of_states_holds_whatever_thrusters_make_of_a_command():
    system = printed(5001).safety.problem.system
    motion, rng, duration = BoxMotion(system, 1.0, 10.0), np.random.default_rng(0), 10.0
    start = BoxFilter(motion, np.zeros(6), np.zeros(6))
    command = 0.5 * system.u_max
    start.flown(np.array([-command, command]), True)
    ahead = start.propagated(start.t + duration)
    Ad, Bd = discretize(system.A, system.B, duration)
    reach = np.zeros(6)
    for _ in range(200):
        u = rng.choice([-1, 1], 3) * command
        x = Bd @ (u + rng.choice([-1, 1], 3) * system.thrusters.error(u))
        assert np.all(np.abs(x) <= ahead[:6]) and np.all(np.abs(x) <= ahead[6:])
        reach = np.maximum(reach, np.abs(x))
    assert np.any(reach > np.abs(Bd) @ command), "without their errors it does not"


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
    made = source_docs.table()
    assert made in text, "run: python -m docs.generate.source_docs"
    assert all(pydoc.locate(place) is not None for place in source_docs.HEAD.values() if place)
    assert {row.table.split(".")[0] for row in source_docs.ROWS} <= set(ScenarioModel.model_fields)
    assert all(f"`{source.__name__}`" in made for source in SOURCES)


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
    named = set(re.findall(r"\w+", " ".join(texts)))
    keys = [key for tables in CHECKED.values() for key in listed(tables)]
    errors = {key for key in keys if key.split(".")[0] in ("navigation", "thrusters", "timing", "faults")}
    missing = {key for key in errors if key.split(".")[-1] not in named}
    assert missing == FORMS, sorted(missing ^ FORMS)


@pytest.mark.parametrize("row", source_docs.ROWS, ids=lambda row: row.name)
def test_the_checker_has_as_many_states_as_the_loop(row):
    declared = source_docs.Declared((*row.beside, *row.example))
    system, h = declared.problem.system, declared.problem.period
    assert declared.craft.F.nrows() == craft_loop(system, h).N


def test_forged_errors_are_refused(tmp_path):
    """The scenario's bounds are the certificate's: no smaller ones pass, wherever they are written."""
    forger = Forger(make([COARSE.replace("0.5", "0.25"), *ERRORS], tmp_path), tmp_path)
    assert forger.judge({}).outcome == "VERIFIED"
    names = forger.honest["assumptions"]
    data = forger.tree(CERTIFICATE)
    for forged, claim in (
        ({"system": data["system"] | {"estimate_error": [(0.001).hex()] * 4}}, "assumptions"),
        ({"system": {k: v for k, v in data["system"].items() if k != "estimate_error"}}, "assumptions"),
        ({"chaser_radius": (0.01).hex()}, "assumptions"),
    ):
        verdict = forger.judge({CERTIFICATE: json.dumps(data | forged)})
        assert (verdict.outcome, verdict.claim) == ("REJECTED", claim)
    exact = {"system": {k: v for k, v in data["system"].items() if k != "thrusters"}}
    ideal = [w for w in names if not w.startswith("thrusters")]
    verdict = forger.judge({CERTIFICATE: json.dumps(data | exact | {"assumptions": ideal})})
    assert (verdict.outcome, verdict.claim) == ("REJECTED", "system")
    feedback_bound = data["feedback_bound"]
    for forged, claim in (
        ([[(20 * float.fromhex(x)).hex() for x in row] for row in feedback_bound], "goal"),
        ([[(0.5 * float.fromhex(x)).hex() for x in row] for row in feedback_bound], "recoverable"),
        ([*feedback_bound[:-1], [(1e-6).hex()] * len(feedback_bound[0])], "recoverable"),
        (feedback_bound[::-1], "format"),
    ):
        verdict = forger.judge({CERTIFICATE: json.dumps(data | {"feedback_bound": forged})})
        assert verdict.outcome == "REJECTED" and verdict.claim in (claim, "margins")
    smaller = {"system": data["system"] | {"estimate_error": [(0.001).hex()] * 4}}
    words = [w.replace("[0.01, 0.01, 0.002, 0.002]", "[0.001, 0.001, 0.001, 0.001]") for w in names]
    verdict = forger.judge({CERTIFICATE: json.dumps(data | smaller | {"assumptions": words})})
    assert (verdict.outcome, verdict.claim) == ("REJECTED", "system")
    point = [w.replace("within 0.05 m", "within 0.04 m") for w in names]
    forged = data | {"chaser_radius": (0.04).hex(), "assumptions": point}
    verdict = forger.judge({CERTIFICATE: json.dumps(forged)})
    assert (verdict.outcome, verdict.claim) == ("REJECTED", "unsafe_sets")
    scenario = forger.tree("scenario.toml")
    scenario["navigation"]["state_error"] = [0.03] * 4
    assert forger.judge({"scenario.toml": write_toml(scenario)}).outcome == "REJECTED"
