"""Faults that are isolated late (Proposition 8): in sets, certificates, and flown where they are worst."""

import copy
import json
from contextlib import suppress
from functools import cache

import flint
import numpy as np
import pytest

from polaris import Tracking, falsify, synthesize
from polaris.certificate.claims.argument import Argument
from polaris.certificate.files.artefacts import FileClaims
from polaris.certificate.files.document import Document
from polaris.certificate.files.repeated import limit_names
from polaris.certificate.kernel.balls import PRECISION
from polaris.certificate.kernel.verdict import Record, Rejected
from polaris.certificate.model.transients import check_attribution
from polaris.model.errors import PolarisError, ScenarioError, SynthesisInfeasible
from polaris.runs.case import replay, write_case
from polaris.runs.certificate import certificate
from polaris.runs.files.tables import besides
from polaris.runs.schedule import guarantee
from polaris.scenario.scenario import load_scenario, scenario_folder
from tests.polaris.forging import Forger, make
from tests.polaris.synthesis.sources.test_error_sources import exact, tables
from tests.polaris.tiny import TINY

SOFT = ["tracking.R=[60.0,60.0]", "feedback.period_s=0.25"]
LATE = 'faults=[{kind="loss",share=0.1,isolation_s=0.3}]'
LOST = 'faults=[{kind="navigation_lost",lasts_s=1.0}]'
KINDS = ("loss", "stuck_off", "stuck_on", "navigation_lost")


def faults(scenario, seed):
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
    assignments = [x for x in tables(scenario, seed, 0.05) if "thrusters" not in x] if errors else []
    with suppress(PolarisError):
        return synthesize(scenario.with_assignments([*assignments, *faults(scenario, seed)]))


def checked(schedule):
    """Return True if the checker's argument holds, the fault derived by itself."""
    document, record = Document(json.loads(json.dumps(certificate(schedule, "scene")))), Record()
    with flint.ctx.workprec(2 * PRECISION):
        Argument(document, record, FileClaims(margins=[float(x) for x in schedule.margins])).run()
    return ("guarantee", "proved") in record.checked


def test_a_proof_holds_with_a_fault_in_every_flight():
    schedule = made(5007)
    assert checked(schedule) and schedule.share() > 0.5
    assert falsify(schedule, 300, 5007).failure is None


def test_a_fault_across_everything_else_that_moves_is_confirmed():
    narrow = ["initial_set.half_widths=[0.0, 0.05, 0.0, 0.01]", "system.disturbance_max=0.0"]
    narrow.append('experimental.0.reference={kind="shared"}')
    assert checked(synthesize(load_scenario(TINY).with_assignments([*SOFT, LATE, *narrow])))


def pulsing(scenario, kind):
    """Assignments of pulses, of impulses whose rest is carried, and of a fault that is isolated late."""
    period, least = scenario.period(), scenario.system().u_max.min()
    pulses = ["thrusters.pulse=centred", "thrusters.remainder=carried"]
    pulses += [f"thrusters.impulse_bit_N_s={float(0.02 * period * least)!r}"]
    keys = "share=0.1,isolation_s" if kind == "loss" else "lasts_s"
    return [*pulses, f"feedback.period_s={period!r}", f'faults=[{{kind="{kind}",{keys}={1.3 * period!r}}}]']


def test_late_faults_go_with_pulses_and_impulses_that_are_carried():
    scenario = load_scenario(TINY).with_assignments(SOFT)
    schedule = synthesize(scenario.with_assignments(pulsing(scenario, "loss")))
    assert checked(schedule) and falsify(schedule, 300, 0).failure is None


NETWORK = (
    f'experimental=[{{kind="neural",name="hasty",path="{scenario_folder()}/policies/hasty.onnx",'
    'inputs=["error"],output_scale_N=1.0,reference={kind="shared"}}]'
)


@pytest.mark.parametrize(
    ("fault", "precision"), [(LATE, "float32"), pytest.param(LOST, "real", marks=pytest.mark.slow)]
)
def test_networks_fly_where_a_fault_may_be_isolated_late(fault, precision):
    network = NETWORK.replace('name="hasty"', f'name="hasty",precision="{precision}"')
    assignments = [*SOFT, network, fault, "recoverable.recourse=none"]
    schedule = synthesize(load_scenario(TINY).with_assignments(assignments))
    law, (transient,) = schedule.controllers[1], schedule.safety.problem.system.transients
    assert schedule.share() > 0.1 and checked(schedule)
    assert fault == LATE or falsify(schedule, 300, 0).failure is None
    pair = np.random.default_rng(0).normal(size=(2, 400, 4))
    one, other = (law.command(0, law.reference.chi[0], law.own.chi[0], law.own.chi[0] + x) for x in pair)
    assert np.all(np.abs(one - other) <= np.abs(pair[0] - pair[1]) @ transient.networks.T)


@pytest.mark.parametrize(
    "given", [["timing.jitter_s=0.03"], ["thrusters.pulse=start", "thrusters.fall_s=0.03"]]
)
def test_a_thruster_fails_for_as_long_as_commands_without_it_are_late(given):
    late = 'faults=[{kind="loss",share=0.1,isolation_s=0.25}]'
    schedule = synthesize(load_scenario(TINY).with_assignments([*SOFT, late, *given]))
    document = Document(json.loads(json.dumps(certificate(schedule, "scene"))))
    with flint.ctx.workprec(2 * PRECISION):
        derived = Argument(document, Record(), FileClaims()).upsets
    for box in (*(each.added[0].sum(axis=1) for each in schedule.safety.tracking.transients), *derived):
        sizes = [float(x) for x in (box.entries() if isinstance(box, flint.arb_mat) else box)]
        assert max(sizes[2:4]) >= 0.1 * (0.25 + 0.03) * (1 - 1e-6)
    assert checked(schedule)


OBSERVED = "navigation.measurement={matrix=[[1,0,0,0],[0,1,0,0]],error=[0.002,0.002]}"


@pytest.mark.parametrize("given", [LATE, pytest.param(LOST, marks=pytest.mark.slow)])
def test_an_observer_goes_with_late_faults_and_needs_what_they_add(given, monkeypatch):
    stiff = [*SOFT[1:], "tracking.R=[200,200]", OBSERVED, given]
    scenario = load_scenario(TINY).with_assignments(stiff)
    schedule = synthesize(scenario)
    assert checked(schedule) and falsify(schedule, 200, 0).failure is None
    nothing = lambda self, rows: np.zeros((self.settling + 3, len(rows)))  # noqa: E731
    monkeypatch.setattr(Tracking, "transient_tightening", nothing)
    with pytest.raises(Rejected):
        checked(synthesize(scenario))


@pytest.mark.parametrize("late", [0, 2])
@pytest.mark.parametrize("observed", [True, False])
@pytest.mark.parametrize("answer", [1, -1])
def test_a_flight_computer_stays_within_what_faults_need(late, observed, answer):
    assignments = [*SOFT[1:], "tracking.R=[200,200]", f"timing.delay_s={0.25 * late}", *[OBSERVED] * observed]
    problem = load_scenario(TINY).with_assignments([*assignments, LATE.replace("0.3", "0.6")]).problem()
    tracking = Tracking(problem.system, problem.gain, problem.feedback, problem.delta, 0.9)
    system, fault, parts, length = problem.system, problem.system.transients[0], 20, 3
    flow = type(tracking.flow).continuous(system.A, system.D, 0.0, 0.25 / parts)
    whole = type(tracking.flow).continuous(system.A, system.D, 0.0, 0.25)
    push, input_map = flow.input_map(system.B), whole.input_map(system.B)
    gain, measures = (system.observer.gain, system.observer.measures) if observed else (np.eye(4), np.eye(4))
    rows = np.vstack([np.eye(4), -np.eye(4)])
    states, commands = (
        tracking.transient_tightening(rows)[:, :4],
        tracking.transient_tightening(tracking.commands)[:, :2],
    )
    x, estimate, history, sent = np.zeros(4), np.zeros(4), [np.zeros(4)], [np.zeros(2)]
    begin = length - fault.lasts / 0.25  # in periods; S flies from node `length` on
    for i in range(200):
        for j in range(parts):
            wrong = fault.pushes[-1] * (begin <= i + (j + 1) / parts - 1e-9 and i < length)
            x = flow.phi @ x + push @ (sent[i] + wrong)
            lag = max(i - length + 1, 0)
            assert np.all(np.abs(x) <= states[min(lag, len(states) - 1)])
        history.append(x)
        if (node := i + 1 - late) > 0:  # the estimate of the state so many periods before
            estimate = whole.phi @ estimate + input_map @ sent[node - 1]
            estimate = estimate + gain @ measures @ (history[node] - estimate)
        expected = estimate
        for u in sent[max(node, 0) :]:
            expected = whole.phi @ expected + input_map @ u
        sent.append(-(answer if i + 1 < length else 1) * tracking.gain @ expected)
        assert np.all(
            np.abs(tracking.gain @ expected) <= commands[min(max(i - length, 0), len(commands) - 1)]
        )
    assert np.all(np.abs(x) < 1e-3 * states[-1])


@pytest.mark.parametrize("given", [LATE, LOST])
def test_a_fault_needs_what_a_flight_with_it_reaches(given):
    """S alone, from a box that is left; that of an outage is what the worst disturbance makes of rest."""
    problem = load_scenario(TINY).with_assignments([*SOFT, given]).problem()
    tracking = Tracking(problem.system, problem.gain, problem.feedback, problem.delta)
    rows, (fault,) = np.vstack([problem.system.position, tracking.gain]), problem.system.transients
    box = np.max([each.support(np.eye(tracking.loop.N)) for each in tracking.transients], axis=0)
    reached = np.max(np.abs(rows @ tracking.transitions) @ box, axis=0)
    bound = tracking.transient_tightening(rows)[-1]
    assert np.all(reached <= bound) and np.all(reached > 0.8 * bound)
    if given == LOST:
        w, age = problem.system.w_max, fault.lasts + tracking.flow.h
        assert box == pytest.approx([w * age**2 / 2] * 2 + [w * age] * 2, rel=1e-6)


def test_an_outage_moves_a_flight_by_no_more_than_it_needs():
    assignments = [*SOFT[1:], "tracking.R=[200,200]", OBSERVED, LOST, "timing.delay_s=0.25"]
    problem = load_scenario(TINY).with_assignments([*assignments, "system.disturbance_max=0.0"]).problem()
    tracking = Tracking(problem.system, problem.gain, problem.feedback, problem.delta, 0.9)
    observer, first, nodes = problem.system.observer, 250, 300
    whole = type(tracking.flow).continuous(problem.system.A, problem.system.D, 0.0, 0.25)
    input_map, runs = whole.input_map(problem.system.B), 2 * first
    noise = np.zeros((runs, nodes, 2))
    for i, axis in np.ndindex(first, 2):
        noise[2 * i + axis, i, axis] = observer.noise[axis]
    flights = []
    for outage in (0, 4):  # updates that are not made; S steers what is estimated
        x, estimate = np.zeros((runs, 4)), np.zeros((runs, 4))
        history, sent, rows = [x], [np.zeros((runs, 2))], []
        for i in range(nodes):
            x = x @ whole.phi.T + sent[i] @ input_map.T
            history.append(x)
            if i:  # what was measured a period ago
                estimate = estimate @ whole.phi.T + sent[i - 1] @ input_map.T
                learned = (history[i] - estimate) @ observer.measures.T + noise[:, i]
                estimate = estimate + learned @ observer.gain.T * (not first <= i < first + outage)
            expected = estimate @ whole.phi.T + sent[i] @ input_map.T
            sent.append(-expected @ tracking.gain.T)
            rows.append(np.hstack([x, -x, sent[-1], -sent[-1]]))
        flights.append(np.array(rows))
    reached = np.abs(flights[1] - flights[0]).sum(axis=1).max(axis=0)
    tightening = np.concatenate(
        [
            tracking.transient_tightening(np.vstack([np.eye(4), -np.eye(4)]))[-1],
            tracking.transient_tightening(tracking.commands)[-1],
        ]
    )
    assert np.all(reached <= tightening) and np.all(reached > 0.5 * tightening)


@pytest.mark.parametrize("told", ['kind="stuck_on",isolation_s=2.0', 'kind="navigation_lost",lasts_s=6.0'])
def test_faults_left_out_of_the_proof_break_it(told, tmp_path):
    """Flights refute a schedule that was made without faults, and the case can be flown again."""
    ways = [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]] * 2
    twos = [f"thrusters.directions={ways}", "thrusters.thrust_max_N=1.0"]
    scenario = load_scenario(TINY).with_assignments([*SOFT, *twos, 'faults=[{kind="stuck_off"}]'])
    late = scenario.with_assignments([f"faults=[{{{told}}}]"])
    schedule, late = synthesize(scenario), late.problem().system.transients
    object.__setattr__(schedule.safety.problem.system, "transients", late)
    search = falsify(schedule, 3000, 0)
    assert search.failure is not None and search.case[0].faults is not None
    replayed, _ = replay(write_case(tmp_path / "case.json", scenario, search))
    assert replayed == search.failure


@pytest.mark.parametrize(
    "late", ['kind="loss",share=0.1,isolation_s=1e4', 'kind="navigation_lost",lasts_s=1e4']
)
def test_what_nothing_bounds_is_refused_by_name(late):
    unstable = "system.A=[[0,0,1,0],[0,0,0,1],[0,0,0.2,0],[0,0,0,0.2]]"
    assignments = [*SOFT, f"faults=[{{{late}}}]", unstable]
    with pytest.raises(ScenarioError, match="must be isolated sooner"):
        synthesize(load_scenario(TINY).with_assignments(assignments))


def test_what_cannot_be_survived_is_named():
    scenario = load_scenario(TINY).with_assignments(SOFT)
    faults = 'faults=[{kind="loss",share=0.3,isolation_s=0.8},{kind="navigation_lost",lasts_s=1.0}]'
    short = r"loss \(0.8 s\) leaves input . [0-9.]+ short in step \d+ \(t = .* alone none is found"
    with pytest.raises(SynthesisInfeasible, match=short) as error:
        synthesize(scenario.with_assignments([faults]))
    assert "navigation_lost (1 s) leaves enough; with this fault alone one is found" in str(error.value)
    longer = faults.replace("lasts_s=1.0", "lasts_s=30.0")  # its loop holds no delay line, others do
    with pytest.raises(SynthesisInfeasible, match=r"navigation_lost \(30 s\) leaves .* short in step"):
        synthesize(scenario.with_assignments([longer, "timing.delay_s=0.25"]))
    with pytest.raises(SynthesisInfeasible, match=short):  # the loop remembers a delay without faults alone
        synthesize(scenario.with_assignments([faults, "timing.delay_s=0.3", "system.disturbance_max=0.003"]))
    with pytest.raises(SynthesisInfeasible, match="Without faults that are isolated late no safe"):
        synthesize(scenario.with_assignments([LOST, "system.input_max=0.1"]))


def test_steps_that_s_flies_because_of_a_fault_are_named_with_what_is_short():
    scenario = load_scenario(TINY).with_assignments([*SOFT, "recoverable.recourse=none"])
    faults = 'faults=[{kind="loss",share=0.1,isolation_s=0.3},{kind="navigation_lost",lasts_s=1.0}]'
    schedule = synthesize(scenario.with_assignments([faults]))
    fault_attribution, fault_steps = guarantee(schedule)["fault_attribution"], set()
    safety, law, starts = schedule.safety, schedule.controllers[1], [schedule.safety.start]
    starts += [step.tube.end for step in schedule.steps]
    tubes = [law.propagate(start, k) for k, start in enumerate(starts[:-1])]
    free = safety.recoverable_with(())
    for fault, transient in zip(fault_attribution, safety.problem.system.transients, strict=True):
        row = dict(besides({"upkeep": None, "fault_attribution": [fault]}))["Isolated late"]
        assert f"fault {fault['fault']} " in row
        for step in fault["steps"]:
            k, tube = step["step"], tubes[step["step"]]
            fault_steps.add(k)
            least = safety.recoverable_with((transient,)).margin(k, tube.nodes, tube.intersample)
            assert schedule.modes[k] == 0 and step["shortfall"] > 0 and not least.inside
            assert (step["limit"], step["tightening"]) == (least.limit, least.tightening)
    for k in np.flatnonzero(schedule.modes == 0).tolist():
        inside = [sets.holds(k, tubes[k].nodes, tubes[k].intersample) for sets in (safety.recoverable, free)]
        assert (inside == [False, True]) == (k in fault_steps)
    assert fault_steps and "fault_attribution" not in guarantee(synthesize(scenario))


LIES = [{"lasts_s": 0.2}, {"fault": "stuck_off"}]
STEP_LIES = [("step", 12), ("shortfall", 0.0), ("limit", "nothing"), ("controller", "S")]
STEP_LIES += [("limit_step", 12), ("t_s", -1.0)]
"""What is not so of a fault, and of a step that S flies because of it."""


def test_forged_transients_are_refused(tmp_path):
    forger = Forger(make([*SOFT, LATE, "simulation.runs=2"], tmp_path), tmp_path)
    assert forger.judge({}).outcome == "VERIFIED"
    for change in (
        lambda faults: faults[0].update(lasts=(0.1).hex()),
        lambda faults: faults[0].update(name="navigation_lost"),
        lambda faults: faults[0]["pushes"].__setitem__(0, [(0.01).hex()] * 2),
        lambda faults: faults[0]["pushes"].pop(),
    ):
        forged = forger.forged(lambda data, change=change: change(data["system"]["transients"]))
        assert forged.outcome == "REJECTED"
    assert forger.forged(lambda data: data["system"].pop("transients")).outcome == "REJECTED"
    document, fault_attribution = (
        Document(forger.honest),
        forger.tree("schedule.json")["guarantee"]["fault_attribution"],
    )
    limits = limit_names(document)
    assert (
        check_attribution(document, fault_attribution, limits) == fault_attribution
        and fault_attribution[0]["steps"]
    )
    for part, lie in [*((None, lie) for lie in LIES), *((0, dict([lie])) for lie in STEP_LIES)]:
        other = copy.deepcopy(fault_attribution)
        (other[0] if part is None else other[0]["steps"][part]).update(lie)
        with pytest.raises(Rejected):
            check_attribution(document, other, limits)
