"""Faults that are isolated late (Proposition 8): in sets, certificates, and flown where they are worst."""

import copy
import dataclasses
import json
from functools import cache

import flint
import numpy as np
import pytest
from scipy.linalg import expm

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
from polaris.simulation.falsification.search import falsify
from polaris.simulation.orbit.environment import Environment
from polaris.simulation.orbit.truth import fly_true
from polaris.synthesis.schedule.synthesize import synthesize
from polaris.synthesis.sources.late_faults import wrong_thrust
from polaris.synthesis.tracker.tracking import Tracking
from tests.polaris.forging import CERTIFICATE, Forger, make
from tests.polaris.synthesis.sources.test_error_sources import exact, tables
from tests.polaris.tiny import TINY
from tests.sizes import fewer

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
    given = [x for x in tables(scenario, seed, 0.05) if "thrusters" not in x] if errors else []
    try:
        return synthesize(scenario.with_assignments([*given, *faults(scenario, seed)]))
    except PolarisError:
        return None


def checked(schedule):
    """Return True if the checker's argument holds, the fault derived by itself."""
    document, record = Document(json.loads(json.dumps(certificate(schedule, "scene")))), Record()
    with flint.ctx.workprec(2 * PRECISION):
        Argument(document, record, FileClaims(margins=[float(x) for x in schedule.margins])).run()
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
    keys = "share=0.1,isolation_s" if kind == "loss" else "lasts_s"
    return [*given, f"feedback.period_s={period!r}", f'faults=[{{kind="{kind}",{keys}={1.3 * period!r}}}]']


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
    steeper = dataclasses.replace(transient, networks=1e6 * transient.networks)
    calm = dataclasses.replace(transient, networks=None)
    gain = schedule.safety.tracking.gain
    loop = schedule.safety.tracking.loop
    least, middle, high = (wrong_thrust(system, each, gain, loop) for each in (calm, transient, steeper))
    limit = wrong_thrust(system, dataclasses.replace(calm, asked=True), gain, loop)
    assert np.all(least <= middle) and np.all(middle <= high) and np.all(high <= limit)
    assert fault == LOST or np.allclose(high.max(axis=0), limit.max(axis=0))  # along the axis that is pushed


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
    bound, box = (
        tracking.transient_tightening(rows)[-1],
        np.max([each.support(np.eye(len(each.added[0]))) for each in tracking.transients], axis=0),
    )
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


@pytest.mark.parametrize(
    "given", [["timing.jitter_s=0.03"], ["thrusters.pulse=start", "thrusters.fall_s=0.03"]]
)
def test_a_thruster_fails_for_as_long_as_commands_without_it_are_late(given):
    """Commanded at its limit, in a period and until the commands of the next one take effect."""
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
@pytest.mark.parametrize("late", [[], pytest.param(["timing.delay_s=0.1"], marks=pytest.mark.slow)])
def test_an_observer_goes_with_late_faults_and_forgets_them(given, late, monkeypatch):
    """It is misled by no more than is added to the loop state, and nearly as much.

    A proof that leaves out what faults need is refused.
    """
    given = given.replace("0.1", "0.03") if late else given
    stiff = [*SOFT[1:], "tracking.R=[200,200]", OBSERVED, given, *late]
    scenario = load_scenario(TINY).with_assignments(stiff)
    schedule = synthesize(scenario)
    tracking, system = schedule.safety.tracking, schedule.safety.problem.system
    assert checked(schedule) and falsify(schedule, 200, 0).failure is None
    parts, fault, off, moved_by, command = 60, system.transients[0], np.zeros(4), np.zeros(4), np.zeros(2)
    flow = type(tracking.flow).continuous(system.A, system.D, 0.0, 0.25 / parts)
    if given == LATE and not late:  # S flies all the time, and knows of the fault only by what it measures
        push, rows = flow.input_map(system.B), np.vstack([np.eye(8), tracking.commands])
        bound, tightening = (
            np.max([each.support(np.eye(len(each.added[0]))) for each in tracking.transients], axis=0),
            tracking.transient_tightening(rows)[-1],
        )
        for i in range(1 - round(fault.lasts / 0.25 * parts), 40 * parts + 1):
            wrong = fault.pushes[-1] * (i <= 0)
            moved_by = flow.phi @ moved_by + push @ (command + wrong)
            off = flow.phi @ off - push @ wrong
            if i % parts == 0:
                off = system.observer.rest @ off
                state = np.concatenate([moved_by, off])
                command = -tracking.gain @ (moved_by + off)
                assert np.all(np.abs(state) <= (bound if i <= 0 else tightening[:8]))
                assert np.all(np.abs(tracking.gain @ (moved_by + off)) <= tightening[8:10])
                assert i < 0 or i > 0 or np.max(np.abs(state) / np.maximum(bound, 1e-12)) > 0.5
    monkeypatch.setattr(
        type(tracking), "transient_tightening", lambda self, rows: np.zeros((self.settling + 3, len(rows)))
    )
    with pytest.raises(Rejected):
        checked(synthesize(scenario))


@pytest.mark.parametrize("late", [0, 1, 2])
@pytest.mark.parametrize("observed", [True, False])
@pytest.mark.parametrize("answer", [1, -1])
def test_a_flight_computer_stays_within_what_faults_need(late, observed, answer):
    """The difference that a fault makes, flown by a computer which knows it only by late measurements.

    While the fault lasts a law with the gains of S answers, or one that steers the other way.
    """
    given = [*SOFT[1:], "tracking.R=[200,200]", f"timing.delay_s={0.25 * late}", *[OBSERVED] * observed]
    problem = load_scenario(TINY).with_assignments([*given, LATE.replace("0.3", "0.6")]).problem()
    tracking = Tracking(problem.system, problem.gain, problem.feedback, problem.delta, 0.9)
    system, fault, parts, length = problem.system, problem.system.transients[0], 20, 3
    flow = type(tracking.flow).continuous(system.A, system.D, 0.0, 0.25 / parts)
    whole = type(tracking.flow).continuous(system.A, system.D, 0.0, 0.25)
    push, held = flow.input_map(system.B), whole.input_map(system.B)
    gain, measures = (system.observer.gain, system.observer.measures) if observed else (np.eye(4), np.eye(4))
    rows = np.vstack([np.eye(4), -np.eye(4)])
    states, commands = (
        tracking.transient_tightening(rows)[:, :4],
        tracking.transient_tightening(tracking.commands)[:, :2],
    )
    x, seen, shown, sent = np.zeros(4), np.zeros(4), [np.zeros(4)], [np.zeros(2)]
    begin = length - fault.lasts / 0.25  # in periods; S flies from node `length` on
    for i in range(200):
        for j in range(parts):
            wrong = fault.pushes[-1] * (begin <= i + (j + 1) / parts - 1e-9 and i < length)
            x = flow.phi @ x + push @ (sent[i] + wrong)
            lag = max(i - length + 1, 0)
            assert np.all(np.abs(x) <= states[min(lag, len(states) - 1)])
        shown.append(x)
        if (node := i + 1 - late) > 0:  # the estimate of the state so many periods before
            seen = whole.phi @ seen + held @ sent[node - 1]
            seen = seen + gain @ measures @ (shown[node] - seen)
        expected = seen
        for u in sent[max(node, 0) :]:
            expected = whole.phi @ expected + held @ u
        sent.append(-(answer if i + 1 < length else 1) * tracking.gain @ expected)
        assert np.all(
            np.abs(tracking.gain @ expected) <= commands[min(max(i - length, 0), len(commands) - 1)]
        )
    assert np.all(np.abs(x) < 1e-3 * states[-1])


def outage(lasts, *given):
    """Return the tracker of an observer whose navigation may be lost for a time [s]."""
    fault = f'faults=[{{kind="navigation_lost",lasts_s={lasts}}}]'
    given = [*SOFT[1:], "tracking.R=[200,200]", OBSERVED, fault, *given]
    problem = load_scenario(TINY).with_assignments(given).problem()
    return Tracking(problem.system, problem.gain, problem.feedback, problem.delta, 0.9)


@pytest.mark.parametrize("late", [0.0, 0.1, 0.5])
def test_updates_that_are_not_made_leave_what_they_would_have_corrected(late):
    """Without disturbance that is the first error, carried on by the plant instead of the observer."""
    tracking = outage(1.0, f"timing.delay_s={late}", "system.disturbance_max=0.0")
    whole, known = expm(0.25 * tracking.system.A), tracking.remembered[-4:]
    rest, power = tracking.system.observer.rest @ whole, np.linalg.matrix_power
    bound = np.max([np.abs(power(whole, i) - power(rest, i)) @ known for i in range(1, 5)], axis=0)
    (upset,) = tracking.transients
    assert upset.support(np.eye(tracking.loop.N))[-4:] == pytest.approx(bound, rel=1e-6)


@pytest.mark.parametrize("lasts", [0.25, 1.0, 6.0])
def test_disturbances_during_an_outage_reach_no_more_than_limits_are_tightened_by(lasts):
    """The worst ones that are constant over periods, for S from rest: updates of the first periods fail."""
    tracking = outage(lasts)
    system, flow, gain = tracking.system, tracking.flow, tracking.gain
    whole, rest, held = expm(0.25 * system.A), system.observer.rest, flow.input_map(system.B)
    D, none = flow.input_map(system.D) * system.w_max, np.zeros((4, 4))
    plant = np.hstack([whole - held @ gain, -held @ gain])
    rows = np.vstack([np.eye(4, 8), np.hstack([gain, gain])])
    bound, worst = tracking.disturbance(rows), 0.0
    for count in range(1, 60):
        carried, reached = rows, np.zeros(6)
        for i in range(count, 0, -1):
            seen = np.eye(4) if i * 0.25 <= lasts else rest
            reached += np.linalg.norm(carried @ np.vstack([D, -seen @ D]), axis=1)
            carried = carried @ np.vstack([plant, np.hstack([none, seen @ whole])])
        assert np.all(reached <= bound[count])
        worst = max(worst, np.max(reached / bound[count]))
    assert worst > 0.5


@pytest.mark.parametrize("late", [1, *(pytest.param(i, marks=pytest.mark.slow) for i in (0, 2))])
def test_an_outage_moves_a_flight_by_no_more_than_it_needs(late):
    """Each measurement before it alone is wrong; what that comes to in all is what noise can make of it."""
    given = [*SOFT[1:], "tracking.R=[200,200]", OBSERVED, LOST, f"timing.delay_s={0.25 * late}"]
    problem = load_scenario(TINY).with_assignments([*given, "system.disturbance_max=0.0"]).problem()
    tracking = Tracking(problem.system, problem.gain, problem.feedback, problem.delta, 0.9)
    seen, first, nodes = problem.system.observer, 250, 300
    whole = type(tracking.flow).continuous(problem.system.A, problem.system.D, 0.0, 0.25)
    held, runs = whole.input_map(problem.system.B), 2 * first
    noise = np.zeros((runs, nodes, 2))
    for i, axis in np.ndindex(first, 2):
        noise[2 * i + axis, i, axis] = seen.noise[axis]
    flown = []
    for outage in (0, 4):  # updates that are not made; S steers what is estimated
        x, estimate = np.zeros((runs, 4)), np.zeros((runs, 4))
        shown, sent, rows = [x], [np.zeros((runs, 2))], []
        for i in range(nodes):
            x = x @ whole.phi.T + sent[i] @ held.T
            shown.append(x)
            if (node := i + 1 - late) > 0:
                estimate = estimate @ whole.phi.T + sent[node - 1] @ held.T
                learned = (shown[node] - estimate) @ seen.measures.T + noise[:, i]
                estimate = estimate + learned @ seen.gain.T * (not first <= i < first + outage)
            expected = estimate
            for u in sent[max(node, 0) :]:
                expected = expected @ whole.phi.T + u @ held.T
            sent.append(-expected @ tracking.gain.T)
            rows.append(np.hstack([x, -x, sent[-1], -sent[-1]]))
        flown.append(np.array(rows))
    reached = np.abs(flown[1] - flown[0]).sum(axis=1).max(axis=0)
    tightening = np.concatenate(
        [
            tracking.transient_tightening(np.vstack([np.eye(4), -np.eye(4)]))[-1],
            tracking.transient_tightening(tracking.commands)[-1],
        ]
    )
    assert np.all(reached <= tightening) and np.all(reached > 0.5 * tightening)


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
            schedule = synthesize(scenario.with_assignments([*faults(scenario, seed), *seen]))
        except PolarisError:
            continue
        assert checked(schedule), seed
        assert falsify(schedule, 300, seed).failure is None, seed
        proved += 1
    assert proved >= len(seeds) / 20


@pytest.mark.parametrize("told", ['kind="stuck_on",isolation_s=2.0', 'kind="navigation_lost",lasts_s=6.0'])
def test_faults_left_out_of_the_proof_break_it(told, tmp_path):
    """Flights refute a schedule that was made without faults, and the case can be flown again."""
    ways = [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]] * 2
    twos = [f"thrusters.directions={ways}", "thrusters.thrust_max_N=1.0"]
    known = load_scenario(TINY).with_assignments([*SOFT, *twos, 'faults=[{kind="stuck_off"}]'])
    late = known.with_assignments([f"faults=[{{{told}}}]"])
    schedule, late = synthesize(known), late.problem().system.transients
    object.__setattr__(schedule.safety.problem.system, "transients", late)
    search = falsify(schedule, 3000, 0)
    assert search.failure is not None and search.case[0].faults is not None
    again, _ = replay(write_case(tmp_path / "case.json", known, search))
    assert again == search.failure


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
    "late", ['kind="loss",share=0.1,isolation_s=1e4', 'kind="navigation_lost",lasts_s=1e4']
)
def test_what_nothing_bounds_is_refused_by_name(late):
    """Numbers go beyond floating point: of what a fault does until then, or of a prediction."""
    unstable = "system.A=[[0,0,1,0],[0,0,0,1],[0,0,0.2,0],[0,0,0,0.2]]"
    given = [*SOFT, f"faults=[{{{late}}}]", unstable]
    with pytest.raises(ScenarioError, match="must be isolated sooner"):
        synthesize(load_scenario(TINY).with_assignments(given))


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
    """They are those that U could fly without the fault, and could not with it: by other proofs of each."""
    scenario = load_scenario(TINY).with_assignments([*SOFT, "recoverable.recourse=none"])
    faults = 'faults=[{kind="loss",share=0.1,isolation_s=0.3},{kind="navigation_lost",lasts_s=1.0}]'
    schedule = synthesize(scenario.with_assignments([faults]))
    fault_attribution, named = guarantee(schedule)["fault_attribution"], set()
    safety, law, starts = schedule.safety, schedule.controllers[1], [schedule.safety.start]
    starts += [step.tube.end for step in schedule.steps]
    for fault, transient in zip(fault_attribution, safety.problem.system.transients, strict=True):
        assert (
            f"fault {fault['fault']} "
            in dict(besides({"upkeep": None, "fault_attribution": [fault]}))["Isolated late"]
        )
        for step in fault["steps"]:
            k, tube = step["step"], law.propagate(starts[step["step"]], step["step"])
            named.add(k)
            assert (
                schedule.modes[k] == 0
                and step["shortfall"] > 0
                and not safety.recoverable.holds(k, tube.nodes, tube.intersample)
            )
            assert safety.recoverable_with(()).holds(k, tube.nodes, tube.intersample)
            least = safety.recoverable_with((transient,)).margin(k, tube.nodes, tube.intersample)
            assert (step["limit"], step["tightening"]) == (least.limit, least.tightening) and not least.inside
    for k in set(np.flatnonzero(schedule.modes == 0).tolist()) - named:
        tube = law.propagate(starts[k], k)
        held = [
            sets.holds(k, tube.nodes, tube.intersample)
            for sets in (safety.recoverable, safety.recoverable_with(()))
        ]
        assert held != [False, True]
    assert named and "fault_attribution" not in guarantee(synthesize(scenario))


WRONG = {"step": 12, "shortfall": 0.0, "limit": "nothing", "controller": "S", "limit_step": 12, "t_s": -1.0}
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
    document, fault_attribution = (
        Document(forger.honest),
        forger.tree("schedule.json")["guarantee"]["fault_attribution"],
    )
    limits = limit_names(document)
    assert (
        check_attribution(document, fault_attribution, limits) == fault_attribution
        and fault_attribution[0]["steps"]
    )
    for part, lie in (
        (None, {"lasts_s": 0.2}),
        (None, {"fault": "stuck_off"}),
        *((0, {key: value}) for key, value in WRONG.items()),
    ):
        other = copy.deepcopy(fault_attribution)
        (other[0] if part is None else other[0]["steps"][part]).update(lie)
        with pytest.raises(Rejected):
            check_attribution(document, other, limits)
    without = copy.deepcopy(forger.honest)
    del without["system"]["transients"]
    assert forger.judge({CERTIFICATE: json.dumps(without)}).outcome == "REJECTED"
