"""Powered abort: flown at its worst, forged claims, and what is required of a schedule."""

import copy
import json
import tomllib
from dataclasses import replace
from types import SimpleNamespace

import flint
import numpy as np
import pytest

from polaris import falsify, get_safety, load_scenario, simulate, synthesize
from polaris.certificate.checker import verify_document
from polaris.certificate.claims.argument import Argument
from polaris.certificate.claims.powered import branched
from polaris.certificate.files.artefacts import FileClaims
from polaris.certificate.files.document import Document
from polaris.certificate.kernel.verdict import Record, Rejected
from polaris.certificate.model.plants import precision_for
from polaris.model.errors import NotCertified, PolarisError, SynthesisInfeasible
from polaris.report.html.run_report import aborts
from polaris.runs.case import replay, write_case
from polaris.runs.certificate import certificate
from polaris.runs.files.tables import abort_text
from polaris.simulation.falsification.aborting import aborted, exceeded
from polaris.simulation.fault_times import FaultTimes
from polaris.synthesis.safety.corrections import Corrections
from polaris.synthesis.safety.feedforward import command_errors
from polaris.synthesis.safety.goal_rows import distance
from polaris.synthesis.schedule.abort_branch import AbortBranch, Takeover
from polaris.synthesis.schedule.arrival import SPARE
from reach import Zonotope
from tests.polaris.closed_loops import attack
from tests.polaris.corruptions import scaled
from tests.polaris.forging import CERTIFICATE, COARSE, QUARTER, Forger, make
from tests.polaris.synthesis.sources.test_error_sources import exact, tables
from tests.polaris.synthesis.sources.test_transients import LATE, SOFT
from tests.polaris.tiny import TINY
from tests.sizes import fewer

ORBIT = 'orbit={kind="stationary",state=[0.0,6.0,0.0,0.0],tolerance_m=0.5}'
NOISE = "navigation.state_error=[0.01,0.01,0.001,0.002]"
OWN = f"abort={{{ORBIT},within_s=10.0,delta_v_max_m_s=20.0}}"


@pytest.fixture(scope="module")
def tiny():
    return synthesize(load_scenario(TINY).with_assignments([OWN, QUARTER]))


def proven(schedule):
    return [k for k, way in enumerate(schedule.powered.ways) if way.branch is not None]


def attacked(schedule, runs, seed, steps):
    """Attack aborted flights by two integrators; the largest share of the claimed velocity change spent."""
    tight = 0.0
    for k in steps:
        way, abort = schedule.powered.ways[k], schedule.aborted(k)
        _, _, flights = aborted(schedule, k, runs, np.random.default_rng(seed))
        failure, _ = exceeded(schedule, k, flights)
        assert failure.margin >= -1e-6, (seed, k, failure.limit)
        q, problem = abort.safety.clearance.q, abort.safety.problem
        impulse = np.abs(flights.inputs[:, k * q : way.cell * q]).sum(axis=(1, 2)).max() * problem.delta / q
        tight = max(tight, impulse / problem.system.mass / way.delta_v)
        if min(abort.margins[abort.modes > 0], default=0) >= 0:  # else other branches serve the steps before
            worst = attack(abort, runs, seed)
            assert worst.left.min() >= -1e-3 and worst.over <= 1e-6, (seed, k)
    return tight


def test_aborted_flights_reach_their_orbit(tiny):
    steps = proven(tiny)
    assert len(steps) == 12 and len(tiny.powered.branches) >= 3
    assert attacked(tiny, 8, 0, (0, 11)) > 0.5
    for k in (3, 10):
        way, runs = tiny.powered.ways[k], simulate(tiny.aborted(k), 40, k, tail=True)
        at = way.cell * tiny.safety.clearance.q
        assert np.abs(runs.positions[:, at] - [0.0, 6.0]).max() < 0.5
        assert way.cell - k <= 10 and not runs.metrics().summary()["collided"]
    assert falsify(tiny, 300, 0).failure is None
    assert "0 to 1" in aborts({"powered_abort": tiny.powered.to_dict()})


def test_a_claim_that_is_too_bold_is_refuted_and_can_be_flown_again(tiny, monkeypatch, tmp_path):
    ways = tuple(replace(way, delta_v=0.4 * way.delta_v) for way in tiny.powered.ways)
    bold = replace(tiny)
    vars(bold)["powered"] = replace(tiny.powered, ways=ways)
    result = falsify(bold, 2000, 0)
    assert result.failure.kind == "abort" and result.abort is not None
    case = write_case(tmp_path / "case.json", load_scenario(TINY).with_assignments([OWN, QUARTER]), result)
    assert replay(case)[0] is None
    monkeypatch.setattr("polaris.runs.case.synthesize", lambda scenario: bold)
    assert str(replay(case)[0]) == str(result.failure)
    sooner = tuple(replace(way, cell=max(way.cell - 4, k + 1)) for k, way in enumerate(tiny.powered.ways))
    vars(bold)["powered"] = replace(tiny.powered, ways=sooner)
    assert falsify(bold, 2000, 0).failure.limit == "orbit"


def test_what_is_required_is_kept_or_refused_with_the_step_and_by_how_much():
    def asked(within, budget, *more):
        table = f"abort={{{ORBIT},within_s={within},delta_v_max_m_s={budget},required=true}}"
        return synthesize(load_scenario(TINY).with_assignments([table, QUARTER, *more]))

    assert abort_text(asked(10.0, 20.0).powered.to_dict()).startswith("from 12 of 12 steps")
    with pytest.raises(NotCertified, match=r"in step \d+ .* raise abort.delta_v_max_m_s by") as scarce:
        asked(10.0, 4.5)
    with pytest.raises(SynthesisInfeasible, match=r"in step \d+ .*no branch is found") as late:
        asked(3.0, 20.0)
    with pytest.raises(NotCertified, match=r"the tank holds 9 m/s; raise tank.delta_v_m_s by"):
        asked(10.0, 20.0, "tank.delta_v_m_s=9.0")
    assert (scarce.value.exit_code, late.value.exit_code) == (4, 3)


def test_the_tank_counts_what_the_schedule_has_spent_before(tiny):
    scale = tiny.safety.tracking.flow.h / tiny.safety.problem.system.mass
    delta_v = np.cumsum([0.0, *(spell.thrust.sum() for spell in tiny._spells)]) * scale
    delta_v = delta_v[np.arange(12) + (tiny.modes > 0)]
    tank = float(np.median(delta_v + [way.delta_v for way in tiny.powered.ways]) * 1.02)
    schedule = synthesize(load_scenario(TINY).with_assignments([OWN, QUARTER, f"tank.delta_v_m_s={tank!r}"]))
    slack = [tank - delta_v[k] - schedule.powered.ways[k].delta_v for k in proven(schedule)]
    assert 0 < len(slack) < 12 and min(slack) >= 0 and np.array_equal(schedule.modes, tiny.modes)
    assert any("the tank holds" in way.why for way in schedule.powered.ways)
    document = Document(json.loads(json.dumps(certificate(schedule, "tiny"))))
    aborts = [way.delta_v for way in schedule.powered.ways]
    with flint.ctx.workprec(precision_for(document)):
        Argument(document, Record(), FileClaims(tank=tank, aborts=aborts)).run()
        with pytest.raises(Rejected, match="the tank of"):
            Argument(document, Record(), FileClaims(tank=0.5 * tank, aborts=aborts)).run()


def test_a_tank_counts_the_step_in_which_u_is_aborted_and_of_s_all_before():
    start, size = Zonotope(np.zeros(1), np.eye(1)), SPARE + 1
    one = SimpleNamespace(system=SimpleNamespace(n=1))
    safety = SimpleNamespace(start=start, clearance=SimpleNamespace(q=2), tracking=one)
    sets = Zonotope(np.zeros((3, 1)), np.ones((3, 1, 1)))
    tube = SimpleNamespace(states=sets, intersample=np.zeros((2, 1)), end=start)
    takeovers = Takeover.for_steps(
        safety, [(0, tube), (1, tube), (0, tube), (1, tube)], np.array([1.0, 2.0, 4.0, 8.0])
    )
    assert [each.cost for each in takeovers] == pytest.approx([0, 3 * size, 3 * size, 15 * size])
    assert [each.start[1:] for each in takeovers] == [(0, 0), (2, 4), (4, 4), (6, 8)]


def test_long_after_a_takeover_a_fault_still_keeps_an_abort_from_its_orbit():
    assignments = [LATE, "feedback.period_s=0.25"]
    safety = get_safety(load_scenario(TINY).with_assignments(assignments).problem())
    tracking, reference = safety.tracking, safety.reference
    branch = AbortBranch(0, safety, Corrections(tracking))
    rows, sides = branch.goal.rows
    one = Zonotope(safety.start.c[None], safety.start.G[None])
    reached = branch._reached(Takeover(0, -100_000, one, np.zeros((1, 4)), 0.0), None)[1]
    states = reference.chi[safety.problem.K :] @ rows.T - sides + tracking.transient_tightening(rows)[-1]
    least = distance(safety.problem.goal.conditions, states + tracking.settled_tightening(rows)).min()
    without = states - tracking.transient_tightening(rows)[-1]
    assert reached >= least > distance(safety.problem.goal.conditions, without).min()


@pytest.fixture(scope="module")
def forger(tmp_path_factory):
    folder = tmp_path_factory.mktemp("powered")
    return Forger(make([COARSE, OWN], folder), folder)


def of_branch(key, change):
    """Change a field of the second branch."""
    return lambda powered, _: powered["branches"][1].update({key: change(powered["branches"][1][key])})


def sooner(powered, claims):
    powered["steps"][2]["cell"] -= 1
    claims[2]["by_s"] -= 1.0


def bolder(powered, claims):
    """A step whose branch has left already."""
    powered["steps"][9] = powered["steps"][0]


FORGED = {
    "inputs": of_branch("inputs", lambda rows: scaled(rows, 0.9)),
    "cheaper": lambda powered, claims: claims[2].update(delta_v_m_s=0.9 * claims[2]["delta_v_m_s"]),
    "facets": of_branch("facets", lambda rows: [[(f + 1) % 4 for f in row] for row in rows]),
    "tail": of_branch("tail", lambda x: [(float.fromhex(x[0]) + 0.5).hex(), *x[1:]]),
    "tolerance": of_branch("tolerance", lambda x: scaled(x, 2.0)),
    "horizon": of_branch("horizon", lambda _: "infinite"),
    "leaves later": of_branch("step", lambda step: step + 1),
    "sooner": sooner,
    "bolder": bolder,
    "longer": lambda powered, claims: powered.update(within=(20.0).hex()),
}
SLOW = {"facets", "tolerance", "horizon", "leaves later"}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW)) for name in FORGED]
)
def test_forged_aborts_are_refused(forger, name):
    powered = copy.deepcopy(forger.honest["powered"])
    files = {}
    for file in ("schedule.json", "summary.json"):
        data = forger.tree(file)
        changed = copy.deepcopy(powered)
        FORGED[name](changed, data["guarantee"]["powered_abort"]["steps"])
        files[file] = json.dumps(data)
    files[CERTIFICATE] = json.dumps(forger.honest | {"powered": changed})
    verdict = forger.judge(files)
    assert verdict.outcome == "REJECTED"
    if name in ("cheaper", "sooner", "longer"):
        assert verdict.claim == "powered_abort"


LATER = "[{from_s=4.0,state_error=[0.004,0.002,0.0,0.0]},{from_s=11.0,state_error=[0.01,0.01,0.001,0.0]}]"


def test_a_branch_meets_the_errors_of_its_steps_and_in_its_tail_the_worst_of_all_later_ones():
    assignments = [COARSE, "tracking.R=[60,60]", f"navigation.phases={LATER}", OWN]
    schedule = synthesize(load_scenario(TINY).with_assignments(assignments))
    data = certificate(schedule, "tiny")
    assert proven(schedule) and verify_document(data).outcome == "VERIFIED"
    assert falsify(schedule, 300, 0).failure is None
    document, gain = Document(data), schedule.safety.tracking.gain
    sooner = 0
    for branch, along in zip(schedule.powered.branches, document.powered.branches, strict=True):
        doc, clearance = branched(document, along), branch.safety.clearance
        errors = [doc.errors_in(k) for k in range(doc.cells)]
        bounds = command_errors(clearance.tracking.system, gain, doc.cells, doc.steps)
        assert bounds == pytest.approx(np.array(errors) @ np.abs(gain).T) and doc.calmest == document.calmest
        assert errors[: doc.steps] == [document.errors_in(k) for k in range(doc.steps)]
        assert errors[-1] == document.errors_in(12) and doc.cells > doc.steps
        sooner += document.errors_in(doc.steps) != errors[-1]
    assert sooner


def test_no_branch_is_safe_for_ever_past_a_set_that_moves(forger):
    """Though the certificate has it rest where all of its way is covered, and all files agree."""
    forged, rests = copy.deepcopy(forger.honest), "the reference does not end on a natural motion trajectory"
    for item in forged["unsafe_sets"]:
        rows = [row for pair in item["offsets"] for row in pair]
        highest = [max(each, key=float.fromhex) for each in zip(*rows, strict=True)]
        item["offsets"] = [[highest, highest] for _ in item["offsets"]]
    for branch in forged["powered"]["branches"]:
        branch["horizon"] = "infinite"
    files = {CERTIFICATE: json.dumps(forged)}
    for file in ("schedule.json", "summary.json"):
        data = forger.tree(file)
        data["guarantee"]["reason"] = rests
        for step in data["guarantee"]["powered_abort"]["steps"]:
            step["safe_until_s"] = None
        files[file] = json.dumps(data)
    verdict = forger.judge(files)
    assert (verdict.outcome, verdict.claim) == ("REJECTED", "end") and "trolley" in verdict.witness


def test_an_honest_abort_is_verified_and_none_may_be_left_out(forger):
    verdict = forger.judge({})
    assert verdict.outcome == "VERIFIED" and "powered_abort" in dict(verdict.checked)
    missing = {k: v for k, v in forger.honest.items() if k != "powered"}
    assert forger.judge({CERTIFICATE: json.dumps(missing)}).outcome == "REJECTED"


def random_orbit(scenario, seed):
    """A table that asks for an orbit near the start of a random scene."""
    rng, step, system = np.random.default_rng(seed), scenario.model.horizon.step_s, scenario.system()
    at, time = scenario.initial_set().c, float(step * rng.integers(8, 20))
    size = np.linalg.norm(at[: system.d]) + 1.0
    if system.mean_motion is None:  # a state at rest
        _, values, rows = np.linalg.svd(system.A)
        rest = rows[values <= 1e-12 * max(values.max(), 1.0)]
        state = (rest.T @ (rest @ (at * rng.uniform(0.5, 1.5, system.n)))).tolist()
        orbit = f'kind="stationary",state={state},tolerance_m={0.2 * size}'
    else:
        orbit = f'kind="elliptical_nmt",inner_semi_minor_m={0.1 * size},outer_semi_minor_m={size}'
    return f"abort={{orbit={{{orbit}}},within_s={time}}}"


def verified(scenario, schedule):
    """The checker derives every abort that is claimed of a scene, its arrival and its velocity change."""
    table = tomllib.loads(scenario.text_elsewhere())
    orbit, document = table["abort"]["orbit"], Document(certificate(schedule, "random"))
    claims = FileClaims(orbit=table["goal"] if orbit["kind"] == "goal" else orbit)
    before, flint.ctx.prec, record = flint.ctx.prec, precision_for(document), Record()
    try:
        Argument(document, record, claims).run()
    finally:
        flint.ctx.prec = before
    return "powered_abort" in dict(record.checked)


@pytest.mark.slow
def test_a_fault_on_the_way_is_allowed_for():
    schedule, k = synthesize(load_scenario(TINY).with_assignments([*SOFT, LATE, OWN])), 5
    assert verify_document(certificate(schedule, "tiny")).outcome == "VERIFIED"
    assert len(proven(schedule)) == 12 and falsify(schedule, 400, 0).failure is None
    (fault,) = schedule.safety.problem.system.transients
    (attacker, _, _), count = aborted(schedule, k, 8, np.random.default_rng(0)), len(fault.thrust)
    ends = np.full(count, schedule.powered.ways[k].cell * schedule.safety.clearance.q)
    begins = ends - int(fault.lasts / schedule.safety.tracking.flow.h + 1e-9)
    share, on_board = np.full(count, fault.share), np.zeros(count, dtype=bool)
    faults = FaultTimes(begins, ends, fault.thrust, share, on_board, np.zeros((count, 4)))
    runs = replace(attacker.worst(count), faults=faults).fly(attacker.flight)
    assert exceeded(schedule, k, runs)[0].margin >= 0


@pytest.mark.slow
def test_many_aborted_flights_reach_their_orbit():
    tight, seeds = [], range(5000, fewer(5060, 5020))
    for seed in seeds:
        scenario = exact(seed)
        table = random_orbit(scenario, seed) if seed % 3 else 'abort.orbit={kind="goal"}'
        try:
            more = tables(scenario, seed, 0.05) if seed % 2 else []
            scenario = scenario.with_assignments([table, *more])
            schedule = synthesize(scenario)
        except PolarisError:
            continue
        if steps := proven(schedule):
            chosen = np.random.default_rng(seed).choice(steps, min(3, len(steps)), replace=False)
            tight.append(attacked(schedule, 30, seed, chosen.tolist()))
            assert falsify(schedule, 300, seed).failure is None
            assert verified(scenario, schedule), seed
    assert len(tight) >= len(seeds) / 10 and np.median(tight) > 0.3
