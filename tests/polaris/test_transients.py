"""Faults that are isolated late (Proposition 8): in sets, certificates, and flown where they are worst."""

import copy
import dataclasses
import json
from functools import cache

import flint
import numpy as np
import pytest

from polaris.certificate.claims.argument import Argument
from polaris.certificate.files.artefacts import Stated
from polaris.certificate.files.document import Document
from polaris.certificate.files.repeated import limit_names
from polaris.certificate.kernel.balls import PRECISION
from polaris.certificate.kernel.verdict import Record, Rejected
from polaris.certificate.model.transients import check_withheld
from polaris.model.errors import PolarisError, ScenarioError, SynthesisInfeasible
from polaris.runs.case import replay, write_case
from polaris.runs.certificate import certificate
from polaris.runs.files.tables import besides
from polaris.runs.schedule import guarantee
from polaris.scenario.scenario import load_scenario, scenario_folder
from polaris.simulation.falsification.search import falsify
from polaris.simulation.orbit.environment import Environment
from polaris.simulation.orbit.truth import fly_true
from polaris.synthesis.schedule.synthesize import synthesize
from polaris.synthesis.sources.late_faults import moved

from ..sizes import fewer
from .forging import CERTIFICATE, Forger, make
from .test_error_sources import exact, tables
from .tiny import TINY

SOFT = ["tracking.R=[60.0,60.0]", "feedback.period_s=0.25"]
LATE = 'faults=[{kind="loss",share=0.1,isolation_s=0.3}]'
LOST = 'faults=[{kind="navigation_lost",lasts_s=1.0}]'
KINDS = ("loss", "stuck_off", "stuck_on", "navigation_lost")


def failing(scenario, seed):
    """Assignments of a fault that is isolated late, of each kind in turn; thrusters come in twos."""
    rng, kind, u_max = np.random.default_rng(seed), KINDS[seed % 4], scenario.system().u_max
    step, m = scenario.step, len(u_max)
    period = scenario.period()
    sampled = [f"feedback.period_s={period!r}"]
    if kind == "navigation_lost":
        return [*sampled, f'faults=[{{kind="{kind}",lasts_s={max(rng.uniform(0.2, 2) * step, period)!r}}}]']
    share = f"share={rng.uniform(0.1, 0.4):.3g}," if kind == "loss" else ""
    ways = np.vstack([np.eye(m), -np.eye(m)] * 2)
    limits = [*u_max.tolist() * 4]
    fault = f'faults=[{{kind="{kind}",{share}isolation_s={period * rng.uniform(1, 2)!r}}}]'
    return [*sampled, f"thrusters.directions={ways.tolist()}", f"thrusters.thrust_max_N={limits}", fault]


@cache
def made(seed, errors=False):
    """Schedule of a random scene with a fault that is isolated late, if it is proved."""
    scenario = exact(seed)
    given = [x for x in tables(scenario, seed, 0.05) if "thrusters" not in x] if errors else []
    try:
        return synthesize(scenario.with_assignments([*given, *failing(scenario, seed)]))
    except PolarisError:
        return None


def checked(schedule):
    """Whether the checker's argument holds, the fault derived by itself."""
    told, record = Document(json.loads(json.dumps(certificate(schedule, "scene")))), Record()
    with flint.ctx.workprec(2 * PRECISION):
        Argument(told, record, Stated(margins=[float(x) for x in schedule.margins])).run()
    return ("guarantee", "proved") in record.checked


@pytest.mark.parametrize("seed", [pytest.param(5006, marks=pytest.mark.slow), 5007])
def test_a_few_proofs_hold_with_a_fault_in_every_flight(seed):
    schedule = made(seed)
    assert checked(schedule) and schedule.share() > 0.5
    assert falsify(schedule, 300, seed).failure is None


def test_a_fault_across_everything_else_that_moves_is_confirmed():
    """Flights differ along one axis alone; the fault pushes along the other, too."""
    narrow = ["initial_set.half_widths=[0.0, 0.05, 0.0, 0.01]", "system.disturbance_max=0.0"]
    narrow.append('experimental.0.reference={kind="shared"}')
    assert checked(synthesize(load_scenario(TINY).with_assignments([*SOFT, LATE, *narrow])))


@pytest.mark.slow
def test_many_proofs_hold_with_a_fault_in_every_flight():
    proved, seeds = [0] * 4, range(5000, fewer(5036, 5016))
    for seed in seeds:
        if (schedule := made(seed, seed % 3 == 0)) is not None:
            assert checked(schedule), seed
            assert falsify(schedule, 600, seed).failure is None, seed
            proved[seed % 4] += 1
    assert sum(proved) >= 0.4 * len(seeds) and min(proved) >= len(seeds) // 12


def pulsing(scenario, kind):
    """Assignments of pulses, of impulses whose rest is carried, and of a fault that is isolated late."""
    period, least = scenario.period(), scenario.system().u_max.min()
    given = ["thrusters.pulse=centred", "thrusters.remainder=carried"]
    given += [f"thrusters.impulse_bit_N_s={float(0.02 * period * least)!r}"]
    told = "share=0.1,isolation_s" if kind == "loss" else "lasts_s"
    return [*given, f"feedback.period_s={period!r}", f'faults=[{{kind="{kind}",{told}={1.3 * period!r}}}]']


@pytest.mark.parametrize("kind", ["loss", pytest.param("navigation_lost", marks=pytest.mark.slow)])
def test_late_faults_go_with_pulses_and_impulses_that_are_carried(kind):
    scenario = load_scenario(TINY).with_assignments(SOFT)
    schedule = synthesize(scenario.with_assignments(pulsing(scenario, kind)))
    assert checked(schedule) and falsify(schedule, 300, 0).failure is None


@pytest.mark.slow
def test_so_they_do_in_random_scenes():
    proved, seeds = 0, range(5003, fewer(5040, 5025), 3)
    for seed in seeds:
        scenario = exact(seed)
        try:
            kind = "loss" if seed % 2 else "navigation_lost"
            schedule = synthesize(scenario.with_assignments(pulsing(scenario, kind)))
        except PolarisError:
            continue
        assert checked(schedule), seed
        assert falsify(schedule, 300, seed).failure is None, seed
        proved += 1
    assert proved >= len(seeds) / 5


NETWORK = (
    f'experimental=[{{kind="neural",name="hasty",path="{scenario_folder()}/policies/hasty.onnx",'
    'inputs=["error"],output_scale_N=1.0,reference={kind="shared"}}]'
)


@pytest.mark.parametrize(
    ("fault", "precision"),
    [
        pytest.param(LATE, "real", marks=pytest.mark.slow),
        (LATE, "float32"),
        pytest.param(LOST, "real", marks=pytest.mark.slow),
    ],
)
def test_networks_fly_where_a_fault_may_be_isolated_late(fault, precision):
    network = NETWORK.replace('name="hasty"', f'name="hasty",precision="{precision}"')
    given = [*SOFT, network, fault, "recoverable.recourse=none"]
    schedule = synthesize(load_scenario(TINY).with_assignments(given))
    system, law = schedule.safety.problem.system, schedule.controllers[1]
    (transient,) = system.transients
    assert schedule.share() > 0.1 and checked(schedule)
    assert fault == LATE or falsify(schedule, 300, 0).failure is None
    pair = np.random.default_rng(0).normal(size=(2, 400, 4))
    one, other = (law.command(0, law.reference.chi[0], law.own.chi[0], law.own.chi[0] + x) for x in pair)
    assert np.all(np.abs(one - other) <= np.abs(pair[0] - pair[1]) @ transient.networks.T)
    steeper = dataclasses.replace(transient, networks=100 * transient.networks)
    calm = dataclasses.replace(transient, networks=None)
    gain = schedule.safety.tracking.gain
    off = np.zeros((1, 4))
    least, found, most = (moved(system, each, gain, 0.25, off) for each in (calm, transient, steeper))
    limit = moved(system, dataclasses.replace(calm, asked=True), gain, 0.25, off)
    assert np.all(least <= found) and np.all(found <= most) and np.allclose(most, limit)


@pytest.mark.slow
def test_balls_keep_what_faults_need_in_random_scenes():
    proved = flown = 0
    for seed in range(5000, 5020):
        kind, scenario = ("loss", "navigation_lost")[seed % 2], exact(seed)
        late = [x for x in pulsing(scenario, kind) if not x.startswith("thrusters")]
        try:
            schedule = synthesize(scenario.with_assignments([*late, "recoverable.kind=ball"]))
        except PolarisError:
            continue
        assert checked(schedule), seed
        assert falsify(schedule, 300, seed).failure is None, seed
        proved, flown = proved + 1, flown + (schedule.share() > 0)
    assert proved >= 4 and flown >= 1


@pytest.mark.parametrize("given", [LATE, LOST])
def test_what_a_fault_needs_is_what_a_flight_with_it_reaches(given):
    """S alone, from a box that is left, or a thruster that pushes as hard as it may until S knows."""
    tracking = synthesize(load_scenario(TINY).with_assignments([*SOFT, given])).safety.tracking
    rows = np.vstack([tracking.system.position, tracking.gain])
    bound, box = tracking.left(rows, tracking.upsets)[-1].max(axis=1), tracking.upsets.max(axis=0)
    reached = np.max(np.abs(rows @ tracking.transitions) @ box, axis=0)
    assert np.all(reached <= bound) and np.all(reached > 0.8 * bound)
    fault, steps = tracking.system.transients[0], 50
    if not len(fault.thrust):
        w, age = tracking.system.w_max, fault.lasts + tracking.flow.h  # a double integrator, along one axis
        assert box == pytest.approx([w * age**2 / 2] * 2 + [w * age] * 2, rel=1e-6)
        return
    flow = type(tracking.flow).continuous(tracking.flow.A_c, tracking.flow.D, 0.0, fault.lasts / steps)
    x = np.zeros(4)
    for _ in range(steps):
        x = flow.phi @ x + flow.input_map(tracking.system.B) @ fault.pushes[-1]
    assert np.all(np.abs(x) <= box) and abs(x[2]) > 0.4 * box[2]


OBSERVED = "navigation.measurement={matrix=[[1,0,0,0],[0,1,0,0]],error=[0.002,0.002]}"


@pytest.mark.parametrize("given", [LATE, pytest.param(LOST, marks=pytest.mark.slow)])
@pytest.mark.parametrize("late", [[], pytest.param(["timing.delay_s=0.1"], marks=pytest.mark.slow)])
def test_an_observer_goes_with_late_faults_and_forgets_them(given, late, monkeypatch):
    """It is misled by no more than is booked, and nearly as much; a proof without that is refused."""
    given = given.replace("0.1", "0.03") if late else given
    stiff = [*SOFT[1:], "tracking.R=[200,200]", OBSERVED, given, *late]
    scenario = load_scenario(TINY).with_assignments(stiff)
    schedule = synthesize(scenario)
    tracking, system = schedule.safety.tracking, schedule.safety.problem.system
    assert checked(schedule) and falsify(schedule, 200, 0).failure is None
    parts, fault, off, reached = 60, system.transients[0], np.zeros(4), []
    flow = type(tracking.flow).continuous(system.A, system.D, 0.0, 0.25 / parts)
    if given == LATE and not late:  # from the node on at which S flies
        wrong = flow.input_map(system.B) @ fault.pushes[-1]
        for i in range(1 - round(fault.lasts / 0.25 * parts), 40 * parts + 1):
            off = flow.phi @ off - wrong * (i <= 0)
            if i % parts == 0:
                off = system.observer.rest @ off
                reached += [np.abs(off)] if i >= 0 else []
        bound = tracking.misled[0].max(axis=0)
        share = np.array(reached)[:20] / bound[:20]
        assert np.all(share <= 1) and share.max() > 0.5
    monkeypatch.setattr(type(tracking), "misled", [0 * each for each in tracking.misled])
    with pytest.raises(Rejected):
        checked(synthesize(scenario))


@pytest.mark.slow
def test_observers_go_with_late_faults_in_random_scenes():
    proved, seeds = 0, range(5000, fewer(5060, 5030))
    for seed in seeds:
        scenario = exact(seed)
        problem = scenario.problem()
        n, widths = problem.system.n, problem.initial_set.half_widths / 20 + 1e-9
        if problem.system.mean_motion is not None or n % 2:
            continue
        seen = [f"navigation.measurement.matrix={np.eye(n)[: n // 2].tolist()}"]
        seen.append(f"navigation.measurement.error={widths[: n // 2].tolist()}")
        seen += [f"navigation.measurement.initial.state_error={(3 * widths).tolist()}"] if seed % 3 else []
        seen += [f"timing.delay_s={problem.period!r}"] if seed % 5 == 0 else []
        try:
            schedule = synthesize(scenario.with_assignments([*failing(scenario, seed), *seen]))
        except PolarisError:
            continue
        assert checked(schedule), seed
        assert falsify(schedule, 300, seed).failure is None, seed
        proved += 1
    assert proved >= len(seeds) / 20


@pytest.mark.parametrize("told", ['kind="stuck_on",isolation_s=2.0', 'kind="navigation_lost",lasts_s=6.0'])
def test_faults_left_out_of_the_proof_break_it(told, tmp_path):
    """The same flights refute a schedule that was made without them, and the case can be flown again."""
    ways = [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]] * 2
    twos = [f"thrusters.directions={ways}", "thrusters.thrust_max_N=1.0"]
    known = load_scenario(TINY).with_assignments([*SOFT, *twos, 'faults=[{kind="stuck_off"}]'])
    late = known.with_assignments([f"faults=[{{{told}}}]"])
    schedule, late = synthesize(known), late.problem().system.transients
    object.__setattr__(schedule.safety.problem.system, "transients", late)
    found = falsify(schedule, 3000, 0)
    assert found.failure is not None and found.case[0].failing is not None
    again, _ = replay(write_case(tmp_path / "case.json", known, found))
    assert again == found.failure


@pytest.mark.slow
def test_in_the_nonlinear_motion_a_craft_without_measurements_flies_on_its_prediction():
    given = ["feedback.period_s=2.0", "timing.delay_s=2.0", "recoverable.recourse=none"]
    given += ["navigation.position_error_m=0.05", "navigation.velocity_error_m_s=0.002"]
    faults = '{kind="navigation_lost",lasts_s=60.0},{kind="loss",share=0.2,isolation_s=4.0}'
    schedule = synthesize(load_scenario("static").with_assignments([*given, f"faults=[{faults}]"]))
    flown = fly_true(schedule, Environment(schedule.safety.problem.system.mean_motion, 0.9), 24, substeps=1)
    assert not flown.runs.metrics().collided.any()


def test_known_at_once_is_as_before_and_other_numbers_are_not():
    plain = load_scenario(TINY).with_assignments([*SOFT, 'faults=[{kind="loss",share=0.1}]'])
    zero = certificate(synthesize(plain.with_assignments(["faults.0.isolation_s=0.0"])), "tiny")
    assert zero == certificate(synthesize(plain), "tiny") and "transients" not in zero["system"]


@pytest.mark.parametrize(
    "fault",
    [
        'kind="stuck_on"',
        'kind="stuck_on",isolation_s=0.0',
        'kind="navigation_lost"',
        'kind="loss",share=0.1,isolation_s=-1.0',
        'kind="loss",share=0.1,isolation_s=0.01',  # less than the control period
    ],
)
def test_bad_tables_are_refused_by_name(fault):
    with pytest.raises(ScenarioError) as error:
        load_scenario(TINY).with_assignments([f"faults=[{{{fault}}}]"])
    assert error.value.field.startswith("faults")


@pytest.mark.parametrize(
    "late", ['kind="loss",share=0.1,isolation_s=1e3', 'kind="navigation_lost",lasts_s=1e4']
)
def test_what_nothing_bounds_is_refused_by_name(late):
    """Numbers go beyond floating point: of what a fault does until then, or of a prediction."""
    unstable = "system.A=[[0,0,1,0],[0,0,0,1],[0,0,0.2,0],[0,0,0,0.2]]"
    given = [*SOFT, f"faults=[{{{late}}}]", *([unstable] if "lost" in late else [])]
    with pytest.raises(ScenarioError, match="bounded by nothing"):
        synthesize(load_scenario(TINY).with_assignments(given))


def test_what_cannot_be_survived_is_named():
    scenario = load_scenario(TINY).with_assignments(SOFT)
    faults = 'faults=[{kind="loss",share=0.3,isolation_s=0.8},{kind="navigation_lost",lasts_s=1.0}]'
    short = r"loss \(0.8 s\) leaves input . [0-9.]+ short in step \d+ \(t = .* none is found with this fault"
    with pytest.raises(SynthesisInfeasible, match=short) as error:
        synthesize(scenario.with_assignments([faults]))
    assert "navigation_lost (1 s) leaves enough; one is found" in str(error.value)
    with pytest.raises(SynthesisInfeasible, match="without faults isolated late, either"):
        synthesize(scenario.with_assignments([LOST, "system.input_max=0.1"]))


def test_steps_that_s_flies_because_of_a_fault_are_named_with_what_is_short():
    """They are those that U could fly without the fault, and could not with it: by other proofs of each."""
    scenario = load_scenario(TINY).with_assignments([*SOFT, "recoverable.recourse=none"])
    faults = 'faults=[{kind="loss",share=0.1,isolation_s=0.3},{kind="navigation_lost",lasts_s=1.0}]'
    schedule = synthesize(scenario.with_assignments([faults]))
    told, named = guarantee(schedule)["withheld"], set()
    safety, law, starts = schedule.safety, schedule.controllers[1], [schedule.safety.start]
    starts += [step.tube.end for step in schedule.steps]
    for fault, transient in zip(told, safety.problem.system.transients, strict=True):
        assert (
            f"because of {fault['fault']} "
            in dict(besides({"upkeep": None, "withheld": [fault]}))["Isolated late"]
        )
        for step in fault["steps"]:
            k, tube = step["step"], law.fly(starts[step["step"]], step["step"])
            named.add(k)
            assert (
                schedule.modes[k] == 0
                and step["short"] > 0
                and not safety.recoverable.holds(k, tube.nodes, tube.bow)
            )
            assert safety.under(()).holds(k, tube.nodes, tube.bow)
            least = safety.under((transient,)).margin(k, tube.nodes, tube.bow)
            assert (step["limit"], step["need"]) == (least.limit, least.need) and not least.inside
    for k in set(np.flatnonzero(schedule.modes == 0).tolist()) - named:
        tube = law.fly(starts[k], k)
        held = [sets.holds(k, tube.nodes, tube.bow) for sets in (safety.recoverable, safety.under(()))]
        assert held != [False, True]
    assert named and "withheld" not in guarantee(synthesize(scenario))


WRONG = {"step": 12, "short": 0.0, "limit": "nothing", "controller": "S", "limit_step": 12, "t_s": -1.0}
"""Of a step that S flies because of a fault."""


def test_forged_transients_are_refused(tmp_path):
    forger = Forger(make([*SOFT, LATE, "simulation.runs=2"], tmp_path), tmp_path)
    assert forger.judge({}).outcome == "VERIFIED"

    def forged(change):
        data = copy.deepcopy(forger.honest)
        change(data["system"]["transients"])
        return forger.judge({CERTIFICATE: json.dumps(data)})

    def shorter(faults):
        faults[0]["lasts"] = (0.1).hex()

    def weaker(faults):
        faults[0]["pushes"][0] = [(0.01).hex(), (0.01).hex()]

    def fewer(faults):
        faults[0]["pushes"].pop()

    def other(faults):
        faults[0]["name"] = "navigation_lost"

    for change in (shorter, weaker, fewer, other):
        verdict = forged(change)
        assert verdict.outcome == "REJECTED", change.__name__
    document, told = Document(forger.honest), forger.tree("schedule.json")["guarantee"]["withheld"]
    limits = limit_names(document)
    assert check_withheld(document, told, limits) == told and told[0]["steps"]
    for part, lie in (
        (None, {"lasts_s": 0.2}),
        (None, {"fault": "stuck_off"}),
        *((0, {key: value}) for key, value in WRONG.items()),
    ):
        other = copy.deepcopy(told)
        (other[0] if part is None else other[0]["steps"][part]).update(lie)
        with pytest.raises(Rejected):
            check_withheld(document, other, limits)
    without = copy.deepcopy(forger.honest)
    del without["system"]["transients"]
    assert forger.judge({CERTIFICATE: json.dumps(without)}).outcome == "REJECTED"
