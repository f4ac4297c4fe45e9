"""Black boxes: what samples say of them, what they do not say, and that nobody calls it proven."""

import json
import shlex
import shutil
import sys
import time
import tomllib
from dataclasses import replace
from functools import cache
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import binom
from typer.testing import CliRunner

import polaris
from polaris import BlackBox
from polaris.certificate.checker import verify, verify_document
from polaris.certificate.claims.argument import check_statement
from polaris.certificate.files.document import digest
from polaris.certificate.files.inputs import check_statements
from polaris.certificate.kernel.verdict import Rejected
from polaris.cli.app import app
from polaris.model.errors import NoAnswer, NotCertified, PolarisError, ScenarioError
from polaris.rta.methods import METHODS
from polaris.runs.black_box_program import black_box_program
from polaris.runs.campaign import CampaignPlan, ScheduleRuns, local, make_cases, replay_run, run_campaign
from polaris.runs.campaign.folder import read_campaign
from polaris.runs.certificate import certificate
from polaris.runs.run import read_run, run
from polaris.runs.tradeoff_points import needed
from polaris.scenario.reading import write_toml
from polaris.scenario.scenario import ScheduleScenario, load_scenario
from polaris.simulation.integration import Integrator
from polaris.simulation.sampled import SPARE, at_most, flights_needed, outside, synthesize_sampled
from polaris.simulation.simulate import initial_states, simulate
from polaris.synthesis.sources.late_faults import wrong_thrust
from reach import Zonotope, discretize
from tests.polaris.random_scenarios import random_scenario
from tests.polaris.tiny import TINY

tradeoff_module = import_module("polaris.runs.tradeoff")

PERIOD = 0.25
TABLE = {"kind": "black_box", "name": "box", "probability": 0.02}
LIKELY = {"probability": 0.2, "confidence": 0.9}  # so little needs few flights


def document(**table):
    scene = load_scenario(TINY, {"feedback": {"period_s": PERIOD}}).to_dict()
    return scene | {"experimental": [TABLE | table], "simulation": {"runs": 3}}


@cache
def hasty():
    """Return what the box of these tests asks in secret: the affine law of the scene, by time."""
    scenario = load_scenario(TINY, {"feedback": {"period_s": PERIOD}})
    law = scenario.controllers(polaris.get_safety(scenario))[0]
    nodes = law.own.fine(4)[:, :-1].reshape(-1, 4)

    def ask(t, x, xi):
        node = min(round(t / PERIOD), len(nodes) - 1)
        return law.own.nu[min(node // 4, len(law.own.nu) - 1)] + (nodes[node] - x) @ law.gain.T

    return ask


ERRORS = {
    "exact": {},
    "all": {
        "navigation": {"state_error": [0.001, 0.001, 0.0005, 0.0005]},
        "thrusters": {"magnitude_error": 0.01},
        "timing": {"delay_s": 0.01, "jitter_s": 0.0005},
    },
    "carried": {"thrusters": {"impulse_bit_N_s": 0.0002, "remainder": "carried"}},
}


@cache
def safety(errors="exact"):
    return polaris.get_safety(ScheduleScenario.from_dict(document() | ERRORS[errors]))


def box(ask=None, part=None, **more):
    part = part or safety()
    return BlackBox("box", part.problem.system, part.reference, part.tracking, ask or hasty(), **more)


@pytest.mark.parametrize(("probability", "doubt"), [(0.01, 5e-4), (0.02, 1e-3), (0.2, 0.05)])
def test_so_many_flights_are_enough_and_no_fewer_are(probability, doubt):
    count = flights_needed(probability, doubt)
    assert binom.cdf(SPARE, count, probability) <= doubt < binom.cdf(SPARE, count - 1, probability)
    assert at_most(SPARE, count, doubt) <= probability < at_most(SPARE + 1, count, doubt)


def test_the_bound_is_wrong_no_more_often_than_it_says():
    for probability in (0.001, 0.01, 0.1, 0.5, 0.9):
        for flights, error_rate in ((40, 0.05), (300, 0.01)):
            counts = np.arange(flights + 1)
            wrong = np.array([at_most(int(k), flights, error_rate) < probability for k in counts])
            assert binom.pmf(counts, flights, probability) @ wrong <= error_rate


@pytest.mark.parametrize(("errors", "size"), [("all", 1.0), ("all", 0.01), ("carried", 0.01)])
def test_what_keeps_to_the_bands_keeps_to_the_tube_between_the_nodes(errors, size):
    law, rng = box(part=safety(errors)), np.random.default_rng(0)
    start, k = Zonotope.box(np.zeros(4), size * np.array([0.06, 0.05, 0.02, 0.02])), 2
    tube = law.propagate(start, k)
    system, q, parts = law.system, 4, 8
    xi = law.reference.fine(parts * q)[k]
    x = xi[0] + rng.uniform(-1, 1, (200, 4)) @ start.G.T
    Ad, Bd = discretize(system.A, system.B, PERIOD / parts)
    Dd = discretize(system.A, system.D, PERIOD / parts)[1]
    rows = np.vstack([np.eye(4), -np.eye(4), rng.normal(size=(40, 4))])
    axis = np.eye(2)[rng.integers(0, 2, len(x))] * rng.choice([-1.0, 1.0], (len(x), 1))  # all along one axis
    side = np.where(axis == 0, 1.0, axis)
    support = tube.nodes.support(rows)
    for i in range(q):
        command = law.command(k, xi[i * parts], xi[i * parts], x, i * PERIOD)
        K, c, r = tube.fit[i, :, :4], tube.fit[i, :, 4], tube.fit[i, :, 5]
        fitted = (x - xi[i * parts]) @ K.T + c
        u = np.clip(np.clip(command, -system.u_max, system.u_max), fitted - r, fitted + r)
        u[::2] = (fitted + side * r)[::2]  # at the edge of the bands
        w, u = system.w_max * axis, u + side * system.thrusters.error(u)
        drift = rng.choice([-1.0, 1.0], (len(x), system.impulse_rates.shape[1])) @ system.impulse_rates.T
        drift = drift @ discretize(system.A, np.eye(system.n), PERIOD / parts)[1].T
        for part in range(1, parts + 1):
            x = x @ Ad.T + u @ Bd.T + w @ Dd.T + drift
            s, e = part / parts, x - xi[i * parts + part]
            bound = (1 - s) * support[i] + s * support[i + 1] + tube.intersample[i] @ np.abs(rows).T
            assert np.all(e @ rows.T <= bound + 1e-9)
        assert np.all(e @ rows.T <= support[i + 1] + 1e-9)


def test_an_affine_box_is_fitted_to_rounding_and_only_where_states_vary():
    start = Zonotope.box(np.zeros(4), [0.05, 0.0, 0.0, 1e-12])
    tube = box(lambda t, x, xi: 0.3 * (xi - x)[:, :2]).propagate(start, 1)
    assert_allclose(tube.fit[1, :, 0], [-0.3, 0.0], atol=1e-9)
    assert not tube.refused and np.all(tube.fit[0, :, 1:3] == 0.0) and np.all(tube.fit[..., 5] < 1e-7)
    wild = box(lambda t, x, xi: np.sign(np.sin(1e9 * x[:, :2])))
    assert wild.propagate(Zonotope.box(np.zeros(4), np.full(4, 1e61)), 0).refused


def follower(t, x, xi, part=None):
    """Nearly the safety controller: it may fly most of the time."""
    part = part or safety()
    nu = part.reference.nu[min(int(t + 1e-9), len(part.reference.nu) - 1)]
    return nu + 0.8 * (xi - x) @ part.tracking.gain.T


def faulty(width):
    """Return the follower, but with full thrust the wrong way where x starts within a narrow strip."""

    def ask(t, x, xi):
        wrong = (np.abs(x[:, 0] - 0.02) < width) & (t < 0.1)
        return np.where(wrong[:, None], -1.0, follower(t, x, xi))

    return ask


def sampled(ask, errors="exact", **options):
    scenario = ScheduleScenario.from_dict(document() | ERRORS[errors])
    return synthesize_sampled(scenario, safety(errors), [box(ask, safety(errors))], attacks=200, **options)


def leaving(schedule, n=4000, seed=10**8):
    """Share of flights, drawn afresh, that leave their bands."""
    return np.mean(outside(simulate(schedule, n, seed, initial="random", disturbance="random")) > 1)


def started(schedule, x):
    """Return how far flights leave their sets that start at a given position along the first axis."""
    flight = Integrator(schedule, schedule.modes, 1)
    x0 = initial_states(schedule, 50, np.random.default_rng(0), "random")
    x0[:, 0] = x
    return outside(flight.run(x0, np.zeros((flight.steps, 50, 2))))


def test_a_rare_fault_is_within_what_is_said_and_not_found():
    """In 0.1 % of the initial set the box is wrong: 2 % hold; of that strip nothing is said."""
    result = sampled(faulty(5e-5), probability=0.02)
    schedule, bound = result.schedule, result.schedule.sampled_bound
    assert schedule.modes[0] == 1 and schedule.share() > 0.8 and bound.outside <= SPARE
    assert 0.001 <= bound.probability <= 0.02
    assert result.worst.failure is None and result.adverse < 0.05
    assert np.all(started(schedule, 0.02) > 1)
    assert np.mean(started(schedule, 0.03) > 1) < 0.1


def test_no_attempt_counts_flights_of_another(monkeypatch):
    drawn = []

    def flown(schedule, n, seed, **_):
        drawn.append(range(seed, seed + n))
        return np.full(n, np.nan)  # what cannot be worked out has left its bands

    synthesized = polaris.synthesize(ScheduleScenario.from_dict(document()), safety(), [box()])
    monkeypatch.setattr("polaris.simulation.sampled.synthesize", lambda *_, **__: synthesized)
    monkeypatch.setattr("polaris.simulation.sampled.simulate", flown)
    monkeypatch.setattr("polaris.simulation.sampled.outside", lambda runs: runs)
    result = synthesize_sampled(None, safety(), [box()], probability=1e-5)
    assert result.schedule is result.proven and result.worst is None
    assert sum(map(len, drawn)) > 4_000_000 and min(map(min, drawn)) > 0
    ends = sorted((part.start, part.stop) for part in drawn)
    assert all(a[1] <= b[0] for a, b in zip(ends, ends[1:], strict=False))


@pytest.mark.parametrize("asked", [{"confidence": 1.0}, {"probability": 0.0}, {"probability": 1.0}])
def test_certainty_is_refused_with_the_open_interval(asked):
    with pytest.raises(ScenarioError, match="must be > 0 and < 1"):
        synthesize_sampled(None, safety(), [box()], **asked)


RARE = (
    # share of starts with the fault; flights outside, of how many; bound and true share [%]; first step under
    (0.001, 0, 1104, 0.69, 0.06, "box"),
    (0.005, 3, 1104, 1.26, 0.6, "box"),
    (0.02, 0, 1104, 0.69, 0.0, "S"),
    (0.2, 0, 1104, 0.69, 0.0, "S"),
)
"""Full thrust the wrong way in a strip of the initial set, where 2 % of all flights may leave the bands."""


@pytest.mark.slow
@pytest.mark.parametrize(("share", "outside", "flights", "bound", "true", "by"), RARE)
def test_a_frequent_fault_is_seen_and_a_rare_one_need_not_be(share, outside, flights, bound, true, by):
    """A frequent one is seen: the sets of the first step hold it, or the box does not fly that step."""
    result = sampled(faulty(share * 0.05), probability=0.02)
    claim, schedule = result.schedule.sampled_bound, result.schedule
    leaving_rate = leaving(schedule, 5000)
    row = claim.outside, claim.flights, round(100 * claim.probability, 2), round(100 * leaving_rate, 2)
    assert row == (outside, flights, bound, true) and leaving_rate <= claim.probability <= 0.02
    assert by == ("box", "S")[int(schedule.modes[0] == 0)] and result.worst.failure is None
    assert np.mean(started(schedule, 0.02) > 1) == (by == "box")


@pytest.mark.parametrize("errors", ["all", pytest.param("carried", marks=pytest.mark.slow)])
def test_errors_are_flown_and_covered(errors):
    def ask(t, x, xi):
        return follower(t, x, xi, safety(errors)) + 0.02 * np.sin(40 * (x - xi)[:, :2])

    trial = sampled(ask, errors, probability=0.02)
    assert trial.schedule.guarantee == "statistical" and trial.schedule.share() > 0.2
    assert leaving(trial.schedule, 2000) <= trial.schedule.sampled_bound.probability
    assert trial.worst.failure is None
    verdict = verify_document(certificate(trial.schedule, "tiny"))
    assert verdict.outcome == "STATISTICAL", verdict.text()


class Lagging:
    """The follower behind a filter: what it commands depends on all that it was asked in a flight."""

    def __init__(self, lag=0.6):
        self.lag, self.asked = lag, []

    def reset(self, flights):
        self.u = np.zeros((flights, 2))
        self.asked.append([])

    def __call__(self, t, x, xi):
        self.asked[-1].append(t)
        self.u += (1 - self.lag) * (follower(t, x, xi) - self.u)
        return self.u


def test_what_a_box_recalls_is_part_of_its_bands():
    result = sampled(Lagging(), probability=0.02)
    schedule, ask = result.schedule, result.schedule.controllers[1].ask
    assert result.repeats and schedule.sampled_bound.attempts == 1
    assert not any(schedule.modes[:2]) and schedule.modes[2]
    assert leaving(schedule, 2000) <= schedule.sampled_bound.probability
    last = PERIOD * 4 * (np.flatnonzero(schedule.modes)[-1] + 1)
    assert_allclose(ask.asked[-1], np.arange(0, last, PERIOD), atol=1e-12)
    assert any("asked once in every control period" in line for line in schedule.assumptions)


def test_a_method_that_predicts_u_refuses_a_box_that_recalls():
    with pytest.raises(NotCertified, match="memory"):
        METHODS["simplex_implicit"].on(SimpleNamespace(controllers=[box(Lagging())]))


def test_a_trade_off_proves_nothing_of_boxes_and_asks_them_anew(tmp_path, monkeypatch):
    row = {"field": "f", "value": 1.0, "share": 0.9, "guarantee": "statistical"}
    assert needed([row], "f", 0.5)["last_proven"] is None
    scenario, boxes = ScheduleScenario.from_dict(document()), {"box": follower}
    arguments = scenario, tmp_path / "front", {"system.disturbance_max": [0.02]}
    with pytest.raises(ScenarioError, match="executor"):
        polaris.tradeoff(*arguments, black_boxes=boxes, executor=local(1))
    monkeypatch.setattr(tradeoff_module, "_is_complete", lambda *_: True)  # nothing tells whose box it was
    monkeypatch.setattr(tradeoff_module, "run", lambda *_, **more: 1 / (more["black_boxes"] != boxes))
    with pytest.raises(ZeroDivisionError):
        polaris.tradeoff(*arguments, black_boxes=boxes)


def test_what_is_carried_cannot_take_a_flight_back_into_its_bands():
    """Bands are about a motion that stands for the flight, as far from it as what is carried may be."""
    part, flights = safety("carried"), 50
    scenario = ScheduleScenario.from_dict(document() | ERRORS["carried"])
    schedule = polaris.synthesize(scenario, part, [box(part=part)])
    runs, system = simulate(schedule, flights, 1), part.problem.system
    bit, remainder, model = system.timing.carried_impulse, np.zeros((flights, system.m)), runs.states.copy()
    impulse_map = discretize(system.A, system.B, PERIOD)[1] / PERIOD
    for node in range(runs.inputs.shape[1]):
        due = runs.inputs[:, node] * PERIOD + remainder
        remainder = due - np.sign(due) * bit * np.floor(np.abs(due) / bit * (1 + 1e-12))
        model[:, node + 1] += remainder @ impulse_map.T
    arcs, run_excess = part.reference.fine(4), outside(runs)
    assert schedule.sampled_steps
    for step in (step for step in schedule.steps if step.mode):
        at = slice(4 * step.k, 4 * step.k + 4)
        excess = step.tube.outside(model[:, at] - arcs[step.k, :-1], runs.inputs[:, at], np.zeros(system.n))
        assert np.all(excess <= run_excess * (1 + 1e-9))


def drifting():
    """Return a box that drifts from flight to flight, too little to show in the samples."""
    flight_count = [0]

    def ask(t, x, xi):
        flight_count[0] += len(x) * (t == 0)
        return follower(t, x, xi) + 0.02 * np.sin(40 * (x - xi)[:, :2]) + 1e-6 * flight_count[0]

    return ask


def mixing(t, x, xi):
    """Ask as the follower does of many flights at once, and otherwise of one alone."""
    return follower(t, x, xi) - 0.5 * (len(x) < 100)


@pytest.mark.parametrize(("ask", "repeats"), [(drifting(), False), (mixing, False), (follower, True)])
def test_a_box_that_answers_differently_the_next_time_is_noticed(ask, repeats):
    result = sampled(ask, probability=0.02)
    assert result.schedule.guarantee == "statistical" and result.repeats is repeats
    assert any(line.startswith("no drift") for line in result.schedule.assumptions)


@pytest.mark.slow
def test_a_campaign_goes_on_with_the_same_box_alone(tmp_path):
    pytest.importorskip("pyarrow")
    plan = CampaignPlan(make_cases([ScheduleScenario.from_dict(document(**LIKELY))]), 4, batch=2)
    plan = replace(plan, kind=ScheduleRuns(("polaris", "safety", "experimental")))
    boxes, extended = {"box": lambda t, x, xi: 0.9 * follower(t, x, xi)}, replace(plan, runs=6)
    folder = run_campaign(plan.asking(boxes), tmp_path / "runs")
    modes = folder.summary["cases"][0]["modes"]
    assert [modes[mode]["guarantee"] for mode in plan.kind.modes] == ["statistical", "proved", "none"]
    with pytest.raises(PolarisError, match="different schedules"):
        run_campaign(extended.asking({"box": follower}), folder.path)
    with pytest.raises(ScenarioError, match="boxes"):
        run_campaign(extended, folder.path)
    with pytest.raises(PolarisError, match="this process"):
        run_campaign(extended.asking(boxes), folder.path, executor=local(2))
    assert run_campaign(extended.asking(boxes), folder.path).summary["flown"] == 18
    read = read_campaign(folder.path)
    with pytest.raises(ScenarioError, match="must be given with `polaris run"):
        replay_run(read, 0, 0, 1)
    campaign = replace(read, plan=read.plan.asking(boxes))
    assert replay_run(campaign, 0, 0, 1).row["guarantee"] == "statistical"


def test_a_box_that_is_never_followed_leaves_the_proven_schedule():
    result = sampled(lambda t, x, xi: np.tile([1.0, -1.0], (len(x), 1)))
    assert result.schedule.guarantee == "proved" and result.worst is None
    unsaid = polaris.synthesize(ScheduleScenario.from_dict(document()), safety(), [box()])
    assert unsaid.sampled_steps and unsaid.guarantee == "none"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("box")
    return run(ScheduleScenario.from_dict(document()), folder / "run", black_boxes={"box": hasty()}).path


def test_the_run_is_statistical_and_so_is_its_verdict(made):
    summary, verdict = read_run(made).summary, verify(made)
    assert summary["guarantee"]["kind"] == "statistical"
    assert summary["synthesis"]["experimental_share"] > summary["synthesis"]["proven_share"]
    assert summary["synthesis"]["worst_flight"]["violated"] is False
    assert (verdict.outcome, verdict.exit_code) == ("STATISTICAL", 7), verdict.text()
    assert "VERIFIED" not in verdict.text()
    assert any("rest on samples" in text for _, text in verdict.checked)
    for begin in ("distribution", "no drift", "the share proven without"):
        assert any(line.startswith(begin) for line in verdict.trusted), begin
    assert any("other seeds" in line for line in verdict.trusted)


def narrower(data):
    """A band of a negative width holds no command."""
    for fit in filter(None, data["samples"]["fits"]):
        for row in fit[1]:
            row[-1] = (-1.0).hex()


def anything(data):
    data["controllers"][1] = {"name": "box", "kind": "any_thrust"}
    del data["samples"]
    lines = [x for x in data["assumptions"] if not x.startswith(("black", "distribution", "no drift"))]
    data |= {"guarantee": "proved", "assumptions": lines}


FORGERIES = {
    "proved": lambda data: data.update(guarantee="proved"),
    "no samples": lambda data: data.pop("samples"),
    "fewer outside": lambda data: data["samples"].update(probability=(1e-4).hex()),
    "a later attempt": lambda data: data["samples"].update(attempts=40),
    "another step": lambda data: data["samples"].update(fits=[None, *data["samples"]["fits"][:-1]]),
    "narrower": narrower,
    "anything": anything,
}


@pytest.mark.parametrize("name", FORGERIES)
def test_a_forged_certificate_is_refused(name, made):
    data = json.loads((made / "certificate.json").read_text(encoding="utf-8"))
    FORGERIES[name](data)
    verdict = verify_document(data | {"digest": digest(data)})
    assert verdict.outcome in ("REJECTED", "UNKNOWN"), verdict.text()


LESS_SURE = {"probability": 0.3, "confidence": 0.9, "flights": 100, "outside": 10, "attempts": 1}


@pytest.mark.parametrize("other", [LESS_SURE, {"seed": 3}], ids=["less sure", "another seed"])
def test_a_statement_is_what_the_scenario_asks_for(other, made):
    statement = read_run(made).summary["guarantee"]["sampled_bound"]
    check_statements(statement, document())
    assert check_statement(statement | other)
    with pytest.raises(Rejected, match="asked for|seed"):
        check_statements(statement | other, document())


GOOD = """
import json, sys
for line in sys.stdin:
    asked = json.loads(line)
    xi = asked["reference"][:2]
    print(json.dumps({"u": [[0.3 * (r - v) for r, v in zip(xi, x)] for x in asked["x"]]}), flush=True)
"""


def python(text, seconds=20.0):
    return black_box_program([sys.executable, "-c", text], seconds)


ANSWER = "print('{\"u\": [[0, 0], [0, 0]]}', flush=True)"
BAD = {
    "ends": ("raise SystemExit('tired')", "tired"),
    "silent": ("import time; time.sleep(60)", "within"),
    "garbage": ("input(); print('hello', flush=True); input()", "must answer"),
    "half a line": ("input(); print('{\"u\": [', end='', flush=True)", "but ended"),
    "half a line, and waits": ("input(); print('{\"u\": [', end='', flush=True); input()", "within"),
    "after two answers": (f"input(); {ANSWER}; input(); {ANSWER}; raise SystemExit('worn out')", "worn out"),
    "no end": ("while True: print('x' * 65536, end='')", "wrote too much"),
    "unasked": (f"while True: {ANSWER}", "but wrote more"),
    "complaints": ("import sys\nfor _ in range(3000): sys.stderr.write('no! ' * 250)\ninput()", "no!"),
    "never reads": ("import time; time.sleep(60)", "within"),
    "depth": ("input(); print('[' * 100000, flush=True); input()", "must answer"),
    "no text": ("import sys; input(); sys.stdout.buffer.write(b'\\xff\\xfe\\n'); input()", "must answer"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_program_that_does_not_answer_is_one_error(name):
    text, rule = BAD[name]
    states = np.zeros((40_000 if name == "never reads" else 2, 4))  # more than a pipe holds
    seconds = 0.3 if rule == "within" else 20.0
    with python(text, seconds) as controller, pytest.raises(NoAnswer, match=rule) as error:
        for t in range(9):
            controller(t % 3.0, states, np.zeros(4))
    assert "\n" not in str(error.value)


def test_what_a_program_has_started_ends_with_it():
    """Else whoever waits for its output would wait for the other."""
    start = time.monotonic()
    box = shlex.join([sys.executable, "-c", f"input(); {ANSWER}"])
    with black_box_program(["sh", "-c", f"sleep 60 & {box}"]) as controller:
        assert controller(0.0, np.zeros((2, 4)), np.zeros(4)) == [[0, 0], [0, 0]]
    assert time.monotonic() - start < 30


ANSWERS = [[[np.nan, 0.0]], [[np.inf, 0.0]], [[0.0]], [0.0, 0.0], [[]], {}, "fast", None, [[0.0], [1.0, 2.0]]]
ANSWERS += [[[1j, 0]], [[True, False]], [["1", "2"]], [[10**400, 0]], [[None, 0.0]]]


@pytest.mark.parametrize("answer", ANSWERS)
def test_an_answer_that_is_no_command_is_one_error(answer):
    with pytest.raises(NoAnswer, match="must return finite numbers"):
        box(lambda t, x, xi: answer).command(0, np.zeros(4), np.zeros(4), np.zeros((1, 4)))


def test_what_was_found_besides_says_nothing_else(made, tmp_path):
    summary = json.loads((made / "summary.json").read_text(encoding="utf-8"))
    summary["synthesis"]["worst_flight"]["guarantee"] = "proved"
    copied = shutil.copytree(made, tmp_path / "run")
    (copied / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    assert verify(copied).outcome == "REJECTED"


class Refusing:
    """A box that cannot begin a flight."""

    def reset(self, runs):
        raise OSError("no memory left")


@pytest.mark.parametrize(
    ("ask", "match"), [(Refusing(), "no memory left"), (lambda t, x, xi: 1 // 0, "ZeroDivisionError")]
)
def test_a_box_that_fails_is_one_error(ask, match):
    with pytest.raises(NoAnswer, match=match):
        box(ask).command(0, np.zeros(4), np.zeros(4), np.zeros((1, 4)))


def test_a_callable_changes_nothing_but_its_own():
    def scribbles(t, x, xi):
        x += 1.0
        xi += 1.0
        return x[:, :2]

    x, xi = np.zeros((3, 4)), np.zeros(4)
    assert np.all(box(scribbles).command(0, xi, xi, x) == 1.0) and not x.any() and not xi.any()
    with pytest.raises(ScenarioError, match="cannot be started"), black_box_program(["/nowhere/at-all"]):
        pass


def test_the_command_line_flies_a_program_and_a_file_alone_does_not(tmp_path):
    (tmp_path / "scene.toml").write_text(write_toml(document(**LIKELY)), encoding="utf-8")
    command = ["run", str(tmp_path / "scene.toml"), "--no-figures", "--out", str(tmp_path / "run")]
    alone = CliRunner().invoke(app, command)
    assert alone.exit_code == 2 and "--black-box" in alone.output and not (tmp_path / "run").exists()
    box = shlex.join([sys.executable, "-c", GOOD])
    with_box = CliRunner().invoke(app, [*command, "--black-box", f"box={box}"])
    assert with_box.exit_code == 0, with_box.output
    assert "proven for any thrust within the limits" in " ".join(with_box.output.split())
    wrong = CliRunner().invoke(app, [*command, "--black-box", "box='open"])
    assert wrong.exit_code == 2 and "has an unreadable command" in " ".join(wrong.output.split())


def test_a_fault_that_is_isolated_late_may_come_on_top_of_whatever_is_drawn():
    fault = {"kind": "loss", "share": 0.05, "isolation_s": PERIOD}
    soft = {"tracking": {"Q": [25.0] * 4, "R": [60.0] * 2}, "faults": [fault]}
    scenario = ScheduleScenario.from_dict(document() | soft)
    part = polaris.get_safety(scenario)
    system, gain, loop, h = part.problem.system, part.tracking.gain, part.tracking.loop, part.tracking.flow.h
    (transient,) = system.transients
    for lasts, answered in ((1.0, 0), (1.1, 1), (2.0, 1)):  # whole periods after the first node since
        fault = replace(transient, lasts=lasts * h)
        answer = wrong_thrust(system, replace(fault, boxes=True), gain, loop)
        silent = wrong_thrust(system, replace(fault, gains=0 * gain, boxes=False), 0 * gain, loop)
        least = discretize(system.A, system.B, h)[1] @ (2 * system.u_max) * answered
        assert np.all(answer - silent >= least - 1e-12) and np.all(answer - silent <= 1.5 * least + 1e-12)
    settings = {"probability": 0.05, "confidence": 0.99, "attacks": 300}
    result = synthesize_sampled(scenario, part, [box(part=part)], **settings)
    assert result.schedule.sampled_steps and result.worst.failure is None
    verdict = verify_document(certificate(result.schedule, "scene"))
    assert verdict.outcome == "STATISTICAL", verdict.text()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 3, 20])
def test_random_scenes(seed):
    scene = tomllib.loads(random_scenario(seed))
    period = scene["horizon"]["step_s"] / 3
    scene |= {"feedback": {"period_s": period}, "recoverable": {"kind": "polytope", "recourse": "none"}}
    scene.get("schedule", {}).pop("delta_v_max_m_s", None)
    scene["experimental"] = [TABLE]
    scenario = ScheduleScenario.from_dict(scene)
    if seed == 3:
        half = (0.02 * scenario.initial_set().half_widths).tolist()
        error = {"position_error_m": half[0], "velocity_error_m_s": half[-1]}
        error = error if scenario.system().mean_motion else {"state_error": half}
        scene |= {"navigation": error, "thrusters": {"magnitude_error": 0.005}}
    if seed == 0:
        scene |= {"faults": [{"kind": "loss", "share": 0.02, "isolation_s": period}]}
    scenario = ScheduleScenario.from_dict(scene)
    part = polaris.get_safety(scenario)
    nu, top = part.reference.nu, part.problem.system.u_max
    gain = part.tracking.gain * np.random.default_rng(seed).uniform(0.6, 1.1, part.tracking.gain.shape)

    def ask(t, x, xi):
        u = (xi - x) @ gain.T
        return nu[min(int(t / part.problem.delta + 1e-9), len(nu) - 1)] + u + 0.02 * top * np.sin(5 * u / top)

    laws = scenario.controllers(part, {"box": ask})
    result = synthesize_sampled(scenario, part, laws, probability=0.05, confidence=0.99, attacks=100)
    schedule = result.schedule
    assert schedule.sampled_steps and result.worst.failure is None
    verdict = verify_document(certificate(schedule, scenario.name))
    assert verdict.outcome == "STATISTICAL", verdict.text()
    assert leaving(schedule, 2000, 10**9 + seed) <= schedule.sampled_bound.probability
