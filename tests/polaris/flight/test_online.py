"""Online monitor in the flight code: as Python to the last bit, and never bolder than `OnlineMonitor`."""

import json
import math
import os
from dataclasses import replace

import flint
import numpy as np
import pytest
from typer.testing import CliRunner

from polaris.certificate.checker import verify
from polaris.certificate.code.answers import (
    CLIPPED,
    CLOCK,
    COMMAND,
    LATCHED,
    MISSED,
    RANGE,
    REFUSED,
    REPEATED,
    STATE,
    OnlineStep,
    summed,
)
from polaris.certificate.code.online import remembered
from polaris.certificate.code.selftest import answered, selftest
from polaris.certificate.code.text import KEEP, ONLINE_SHAPES, PRECISIONS, files, rounded
from polaris.certificate.files.document import read
from polaris.certificate.kernel.balls import PRECISION, column, matrix
from polaris.certificate.kernel.verdict import Rejected
from polaris.cli.app import app
from polaris.flight.export import export_c
from polaris.flight.vectors import SPECIAL, calls
from polaris.model.errors import ScenarioError
from polaris.rta.arena import compare_methods
from polaris.rta.decision_grid import DecisionGrid
from polaris.rta.methods.monitor import REENTRY, Monitor
from polaris.rta.methods.on_board import MonitorOnBoard
from polaris.rta.online.decision_log import DecisionLog, read_log
from polaris.rta.online.estimate import Measurement
from polaris.rta.online.runtime import OnlineMonitor, replay_log
from polaris.rta.online.runtime_options import RuntimeOptions
from polaris.runs.case import replay, write_case
from polaris.runs.read_schedule import read_schedule, schedule_folder
from polaris.runs.run import run
from polaris.simulation.falsification.search import falsify
from polaris.simulation.on_board import FlightCode
from polaris.simulation.simulate import simulate
from tests.polaris.certificate.test_honest_sources import SOURCES
from tests.polaris.flight.evidence import (
    ADVISORY,
    assert_every_branch_is_taken,
    assert_no_required_rule_is_broken,
    assert_no_run_time_error,
    assert_self_test_passes,
    assert_simple,
)
from tests.polaris.flight.library import FlightLibrary, copied, read_code
from tests.polaris.forging import QUARTER, make
from tests.polaris.random_scenarios import random_scenario

FLIGHTS = 95_000 if os.environ.get("POLARIS_CAMPAIGN") else 300


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """A run folder, and its code with the online monitor in both precisions."""
    place = tmp_path_factory.mktemp("online")
    folder = make([QUARTER], place)
    for precision in PRECISIONS:
        export_c(folder, place / precision, precision, monitor=True)
    return place


@pytest.fixture(scope="module")
def monitor(flown):
    return Monitor(DecisionGrid.from_schedule(read_schedule(flown / "run")))


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_compilers_are_silent_and_the_self_test_passes(flown, tmp_path, compiler, precision):
    assert_self_test_passes(flown / precision, compiler, tmp_path / "test", "-O2")


@pytest.mark.parametrize("precision", PRECISIONS)
def test_the_c_code_decides_as_python_to_the_last_bit(flown, tmp_path, precision):
    _, tables, _ = read_code(flown / precision)
    library, counts, online = FlightLibrary(flown / precision, tmp_path / "flight.so"), {}, False
    for call, expected in answered(tables, precision, calls(tables, FLIGHTS, 1)):
        if call.start:
            online = call.start == 2
            library.decide_from(call.period) if online else library.start()
        step = library.decide if online else library.step
        answer = step(call.period, call.state, call.controller, call.command)
        assert (answer, str(answer.command)) == (expected, str(expected.command)), call
        if online:
            counts[answer.mode, answer.fault] = counts.get((answer.mode, answer.fault), 0) + 1
    assert counts[1, 0] > FLIGHTS / 4 and counts[0, REFUSED] > FLIGHTS / 4 and len(counts) > 15


@pytest.mark.parametrize("precision", PRECISIONS)
def test_the_self_test_takes_every_branch(flown, tmp_path, precision):
    assert assert_every_branch_is_taken(copied(flown / precision, tmp_path / "code")) >= 100


def test_no_required_rule_of_misra_is_broken_and_functions_are_simple(flown, tmp_path):
    _, lines = assert_simple(flown / "double", tmp_path / "code.o", 700)
    assert lines <= 400
    assert_no_required_rule_is_broken(flown / "float", ADVISORY | {"misra-c2012-8.7"})


@pytest.mark.parametrize("precision", PRECISIONS)
def test_no_input_makes_a_run_time_error(flown, tmp_path, precision):
    summary = assert_no_run_time_error(flown / precision, tmp_path, "memory", "online")
    assert summary.count("100% coverage") == 2


# -- decisions --------------------------------------------------------------------------------------


@pytest.mark.parametrize("precision", PRECISIONS)
def test_u_flies_only_where_the_online_monitor_lets_it(flown, tmp_path, monitor, precision):
    """Errors of all sizes at all decisions: never bolder, and nearly always the same answer."""
    library, rng = FlightLibrary(flown / precision, tmp_path / "flight.so"), np.random.default_rng(2)
    grid, agreed, both = monitor.grid, 0, [0, 0]
    inverse = np.linalg.inv(grid.tracking.W)
    for place in range(6000):
        k = int(rng.integers(0, grid.decisions))
        e = inverse @ rng.normal(size=grid.system.n)
        e *= 10 ** rng.uniform(-2, 1) / np.linalg.norm(grid.tracking.W @ e)
        flew = place % 2
        library.decide_from(k)
        library.online.flown = flew
        bold = library.decide(k, grid.xi[k] + e, 1, [0.0] * grid.system.m).mode
        expected, _ = monitor.judge_one(k, e, flew)
        assert bold <= expected, (k, e)
        agreed += bold == expected
        both[bold] += 1
    assert agreed >= 0.97 * 6000 and min(both) > 600
    assert pytest.approx(1 - REENTRY) == KEEP


def test_each_fault_has_its_answer(flown):
    _, tables, _ = read_code(flown / "double")
    n, m, q, u = len(tables.range), len(tables.limit), len(tables.moved), (0.5,) * len(tables.limit)

    def fly(*calls):
        """Calls that follow one another from the period on in which U may fly from the reference."""
        step = OnlineStep(tables)
        step.safe.last = first - 1
        return [step.step(first + at, state, controller, command) for at, state, controller, command in calls]

    def along(node):
        return OnlineStep(tables).safe.gap(*divmod(node, q), [0.0] * n)

    allowed = (
        k for k in range(1, q * len(tables.modes)) if OnlineStep(tables).recoverable(k, along(k), KEEP)
    )
    first = next(k for k in allowed if OnlineStep(tables).recoverable(k + 1, along(k + 1), KEEP))
    x, y = along(first), along(first + 1)
    much = tuple(a + 0.9 * b for a, b in zip(x, tables.apart, strict=True))
    regular, repeated, later = fly((0, x, 7, u), (0, x, 0, u), (1, y, 0, u))
    assert (regular.mode, regular.fault, regular.command) == (7, 0, u)
    assert (repeated.mode, repeated.fault) == (7, REPEATED) and (later.mode, later.fault) == (0, 0)
    for call, fault in [
        ((0, (math.nan, *x[1:]), 1, u), STATE),
        ((0, x, 1, (math.inf,) * m), COMMAND),
        ((0, much, 1, u), REFUSED),
        ((0, (1e5,) * n, 1, u), RANGE),
    ]:
        answer, after = fly(call, (1, y, 1, u))
        assert (answer.mode, answer.fault & ~CLIPPED) == (0, fault)
        assert after.mode == 1  # what was wrong is over
    for at, fault in [(1, MISSED), (-first - 1, CLOCK)]:
        answer, after = fly((at, y, 1, u), (2, y, 1, u))
        assert (answer.mode, answer.fault & ~CLIPPED) == (0, fault | LATCHED)
        assert after.mode == 0 and after.fault & LATCHED  # nobody knows which number is right
    last, step = len(tables.modes) * q, OnlineStep(tables)
    step.safe.last = last - 1
    assert step.step(last, along(last), 1, u).fault & REFUSED  # nothing is planned beyond


@pytest.mark.parametrize("precision", PRECISIONS)
def test_no_thrust_within_the_limits_breaks_a_flight(flown, tmp_path, monitor, precision):
    """The C code decides flights of U that pushes as hard as it can, under disturbances of largest size."""
    library, rng = FlightLibrary(flown / precision, tmp_path / "flight.so"), np.random.default_rng(8)
    grid, by_u, switches = monitor.grid, 0, 0
    Ad, Bd, Dd = grid.discrete
    system, start = grid.system, grid.schedule.safety.problem.initial_set
    for flight in range(200 if FLIGHTS > 1000 else 30):
        x = start.c + start.G @ rng.choice([-1, 1], start.G.shape[1])
        push, before = rng.choice([-1.0, 1.0], system.m) * system.u_max, 0
        library.decide_from(0)
        for node in range(grid.last + 2 * grid.clearance.q):
            if flight % 2 and rng.random() < 0.2:
                push = rng.choice([-1.0, 1.0], system.m) * system.u_max
            answer = library.decide(node, x, 1, push.tolist())
            assert answer.mode or not answer.fault & CLIPPED  # S never needs more than there is
            w = rng.normal(size=system.D.shape[1])
            x = Ad @ x + Bd @ np.array(answer.command) + Dd @ w * (0.99 * system.w_max / np.linalg.norm(w))
            rows, offsets, _ = grid.facets
            clearance = grid.nearest(rows @ x - offsets[node + 1])
            assert clearance > 0, (flight, node, clearance)
            by_u, switches, before = by_u + answer.mode, switches + (answer.mode != before), answer.mode
    assert by_u > 100 and switches > 30


@pytest.mark.parametrize("precision", PRECISIONS)
def test_the_monitor_of_the_code_decides_in_simulation(flown, precision):
    """U asks in every period, under random and the worst disturbances: no set is entered, S never clips."""
    schedule, code = read_schedule(flown / "run"), FlightCode(flown / precision)
    runs = simulate(schedule, n=2000 if FLIGHTS > 1000 else 60, seed=4, tail=True, mode=1, code=code)
    assert runs.metrics().summary()["collided_runs"] == 0
    answers = {(0, 0), (0, REFUSED), (1, 0)}
    assert answers <= code.answers.keys() <= answers | {(1, CLIPPED)}


@pytest.mark.parametrize("precision", PRECISIONS)
def test_the_runtime_on_the_ground_decides_as_the_code(flown, tmp_path, precision):
    """On states of all sizes at all periods, hostile ones too, and whoever flew before."""
    schedule, code = read_schedule(flown / "run"), FlightCode(flown / precision)
    ground = MonitorOnBoard(DecisionGrid.from_schedule(schedule), code)
    library, rng = FlightLibrary(flown / precision, tmp_path / "flight.so"), np.random.default_rng(5)
    grid, spread, counts = ground.grid, np.array(code.tables.apart), {}
    for place in range(20_000 if FLIGHTS > 1000 else 2000):
        k, before = int(rng.integers(0, grid.decisions)), place % 2
        state = grid.xi[k] + rng.uniform(-1, 1, grid.system.n) * spread * 10 ** rng.uniform(-4, 1)
        if place % 5 == 4:
            state[rng.integers(0, grid.system.n)] = rng.choice(SPECIAL)
        library.decide_from(k)
        library.online.flown = before
        answer = library.decide(k, state.tolist(), 1, [0.0] * grid.system.m)
        with np.errstate(invalid="ignore", over="ignore"):
            mode, _, reason = ground.explained(k, state, before)
        assert mode == answer.mode, (k, state)
        refused = "the code" in reason
        counts[mode, refused] = counts.get((mode, refused), 0) + 1
    assert counts.keys() == {(1, False), (0, False), (0, True)}  # a few that `Monitor` would let U fly
    assert min(counts[1, False], counts[0, False]) > place / 5


@pytest.mark.parametrize("precision", PRECISIONS)
def test_flights_on_the_ground_are_those_of_the_code(flown, tmp_path, precision):
    """Clock, checks and log about the tables: where measurements fail, the code is asked for S alone."""
    schedule, code = read_schedule(flown / "run"), FlightCode(flown / precision)
    ground, rng = MonitorOnBoard(DecisionGrid.from_schedule(schedule), code), np.random.default_rng(6)
    library, modes = FlightLibrary(flown / precision, tmp_path / "flight.so"), [0, 0]
    grid, options = ground.grid, RuntimeOptions(latch_conflicts=None)
    (Ad, Bd, Dd), system, start = grid.discrete, grid.system, schedule.safety.problem.initial_set
    for flight in range(6):
        log = DecisionLog(place := tmp_path / f"{flight}.jsonl")
        online, faults = OnlineMonitor(ground, options, log), 0
        library.decide_from(0)
        x, answers = start.c + start.G @ rng.uniform(-1, 1, start.G.shape[1]), []
        for k in range(grid.decisions):
            error = rng.choice([math.nan, 1e7, 3.0]) if rng.random() < 0.1 * (flight % 2) else 0.0
            answers.append(online.step(k * grid.period, Measurement(k * grid.period, x + error), number=k))
            healthy = not answers[-1].faults
            push = (rng.choice([-1.0, 1.0], system.m) * system.u_max).tolist()
            answer = library.decide(k, x, int(healthy), push)
            assert answers[-1].mode == answer.mode, (flight, k, answers[-1])
            modes[answer.mode], faults = modes[answer.mode] + 1, faults + (not healthy)
            w = rng.normal(size=system.D.shape[1])
            x = Ad @ x + Bd @ np.array(answer.command) + Dd @ w * (0.9 * system.w_max / np.linalg.norm(w))
        log.close()
        assert (faults > 0) == flight % 2 and replay_log(read_log(place), ground, options) == answers
    assert min(modes) > 30


def test_the_arena_flies_the_monitor_of_the_code(flown, tmp_path):
    """Beside the schedule, its code, and the monitor in Python, which is a little bolder."""
    schedule, code = read_schedule(flown / "run"), FlightCode(flown / "double")
    keys = "schedule", "code", "monitor", "monitor_code"
    results = compare_methods(schedule, 12, 1, methods=keys, code=code).results
    assert {one.claim.kind for one in results.values()} == {"proved"} and tuple(results) == keys
    assert not any(one.metrics.collided.any() for one in results.values())
    shares = {key: one.metrics.experimental_share for key, one in results.items()}
    assert np.array_equal(shares["schedule"], shares["code"])
    assert 0.1 < shares["monitor_code"].mean() <= shares["monitor"].mean()
    assert np.nanmax(results["monitor_code"].metrics.max_thrust_ratio_safety) <= 1
    options = "--runs 2 --methods schedule,monitor_code --no-figures"
    command = ["compare", str(flown / "run"), *options.split()]
    done = CliRunner().invoke(app, [*command, "--code", str(flown / "float"), "--out", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    methods = json.loads((tmp_path / "out" / "comparison.json").read_text())["methods"]
    assert [(one["key"], one["guarantee"]) for one in methods] == [(key, "proved") for key in keys[::3]]


def test_a_monitor_on_board_needs_its_code_and_its_grid(flown, tmp_path):
    schedule, code = read_schedule(flown / "run"), FlightCode(flown / "double")
    refused = compare_methods(schedule, 1, methods=("safety", "monitor_code")).refused
    assert "must be flight code with the monitor" in refused["monitor_code"]
    export_c(flown / "run", tmp_path / "code")
    with pytest.raises(ScenarioError, match="must be flight code with the monitor"):
        MonitorOnBoard(DecisionGrid.from_schedule(schedule), FlightCode(tmp_path / "code"))
    h = DecisionGrid.from_schedule(schedule).h
    for other in ({"period": 2 * h}, {"latency": h}, {"half_widths": 1e-3}):
        with pytest.raises(ScenarioError, match="must be the control period"):
            MonitorOnBoard(DecisionGrid.from_schedule(schedule, **other), code)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_attacks_fly_the_monitor_of_the_code_and_find_one_that_is_too_bold(flown, tmp_path, precision):
    """U asks in every step; alone it hits what is there, and so it does where a forged monitor lets it."""
    schedule, code = read_schedule(flown / "run"), FlightCode(flown / precision)
    attacks = falsify(schedule, 20_000 if FLIGHTS > 1000 else 300, 3, code=code)
    assert (
        attacks.failure is None and np.isfinite(attacks.least[: len(schedule.safety.clearance.unsafe)]).all()
    )
    assert code.answers.keys() <= {(0, 0), (0, REFUSED), (1, 0), (1, CLIPPED)}
    verdict = forged(flown, tmp_path / "bold", lambda t: {"clearance": with_clearance(t, 3.0)}, precision)
    assert verdict.outcome == "REJECTED"
    attack = falsify(schedule, 300, 3, code=FlightCode(tmp_path / "bold"))
    assert attack.failure is not None and attack.failure.kind in ("unsafe set", "saturation")
    case = write_case(tmp_path / "bold.case.json", schedule_folder(flown / "run").scenario, attack)
    assert replay(case, FlightCode(tmp_path / "bold"))[0] == attack.failure and replay(case, code)[0] is None


# -- the checker ------------------------------------------------------------------------------------


def forged(root, folder, change, precision="double"):
    """Code of altered tables whose text and self-test agree with them; returns the verdict."""
    prefix, tables, _ = read_code(root / precision)
    altered = replace(tables, **change(tables)).rounded(precision)
    digest = read(root / "run" / "certificate.json").digest
    folder.mkdir()
    texts = files(altered, prefix, precision, digest)
    texts[f"{prefix}_selftest.c"] = selftest(altered, prefix, precision, calls(altered, 12, 0))
    for name, text in texts.items():
        (folder / name).write_text(text)
    return verify(root / "run", folder)


def scaled(table, by):
    return [scaled(one, by) for one in table] if isinstance(table, list) else table * by


def with_clearance(tables, by):
    """More room at every limit that there is."""
    return [[[x + by * (i % 2 == 0) for i, x in enumerate(row)] for row in cell] for cell in tables.clearance]


def lowered(tables, lag, by):
    return [[x - by * (i in (lag, None)) for x in row] for i, row in enumerate(tables.booked)]


FORGERIES = {
    "more room": lambda t: {"clearance": with_clearance(t, 1e-3)},
    "more room in one step": lambda t: {"clearance": [with_clearance(t, 1.0)[0], *t.clearance[1:]]},
    "rooms of the step after": lambda t: {"clearance": [*t.clearance[1:], t.clearance[-1]]},
    "rooms that grow": lambda t: {
        "clearance": [[[a, b + 0.01, c, d + 0.01] for a, b, c, d in cell] for cell in t.clearance]
    },
    "fewer rooms": lambda t: {"clearance": t.clearance[:-1]},
    "less booked in the first period": lambda t: {"booked": lowered(t, 0, 0.1)},
    "less booked at the next node": lambda t: {"booked": lowered(t, 1, 0.1)},
    "less booked at the last node": lambda t: {"booked": lowered(t, len(t.booked) - 1, 0.1)},
    "errors of no size": lambda t: {"sized": scaled(t.sized, 0.0)},
    "no margin": lambda t: {"booked": scaled(t.booked, 0.9)},
    "a shorter look ahead": lambda t: {"booked": t.booked[:-9], "sized": t.sized[:-9]},
    "one node": lambda t: {"booked": t.booked[:1], "sized": t.sized[:1]},
    "another row": lambda t: {"rows": [scaled(t.rows[0], 0.99), *t.rows[1:]]},
    "rows exchanged": lambda t: {"rows": [*t.rows[:-2], t.rows[-1], t.rows[-2]]},
    "another loop": lambda t: {"loop": scaled(t.loop, 0.999)},
    "another plant": lambda t: {"held": scaled(t.held, 0.99)},
    "a weaker thruster": lambda t: {"force": scaled(t.force, 0.9)},
    "larger errors": lambda t: {"apart": scaled(t.apart, 3.0)},
    "facets that are none": lambda t: {"facets": t.facets - 1},
}


@pytest.mark.parametrize("label", FORGERIES)
def test_altered_tables_that_agree_with_themselves_are_refused(flown, tmp_path, label):
    verdict = forged(flown, tmp_path / "code", FORGERIES[label])
    assert (verdict.outcome, verdict.claim) == ("REJECTED", "monitor"), verdict.witness


@pytest.mark.parametrize("precision", PRECISIONS)
def test_an_honest_code_is_confirmed_and_its_margin_is_near(flown, tmp_path, precision):
    verdict = forged(flown, tmp_path / "code", lambda t: {}, precision)
    assert verdict.outcome == "VERIFIED" and "monitor" in dict(verdict.checked)
    assert any("online monitor" in assumption for assumption in verdict.trusted)
    _, tables, _ = read_code(flown / precision)
    for name in ONLINE_SHAPES:
        assert getattr(tables, name) == getattr(tables.rounded(precision), name)
    rows = np.array(tables.rows)
    assert np.abs(rows).max() == rounded(np.abs(rows).max(), precision)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_rounding_of_values_is_within_its_bound_and_the_bound_is_near(flown, monkeypatch, precision):
    """Against balls, along every limit at every node that a decision looks at, errors of all signs."""
    calls, place = [], "polaris.certificate.code.online._check_clearances"
    monkeypatch.setattr(place, calls.append)
    assert verify(flown / "run", flown / precision).outcome == "VERIFIED"
    flight, tables, loss = calls[0].flight, calls[0].tables, np.array(calls[0].rounding_loss, dtype=float)
    monkeypatch.setattr(flint.ctx, "prec", PRECISION)
    craft, doc, rng = flight.tracker.craft, flight.document, np.random.default_rng(4)
    step, q, worst = OnlineStep(tables, precision), doc.q, np.zeros_like(loss)
    rows, signs = flight.recovery.tightenings.full_rows, [(i, side - 1.0) for i, side, _ in calls[0].stored]
    for draw in range(300):
        cell, part = divmod(int(rng.integers(0, doc.steps * q)), q)
        node = flight.path.arcs[cell].nodes[part]
        b = rng.choice([-1, 1], len(tables.apart)) if draw % 2 else rng.uniform(-1, 1, len(tables.apart))
        x = np.array(node.tolist(), dtype=float)[:, 0] - 0.999 * b * tables.apart
        gap = step.safe.gap(cell, part, [rounded(one, precision) for one in x.tolist()])
        e, feed = node - column(x.tolist()), column(doc.inputs[cell])
        for lag in range(len(loss)):
            values = [summed(0.0, row, gap, precision) for row in tables.rows]
            exact = (rows * e).entries()
            errors = [float(abs(y - s * values[k]).upper()) for y, (k, s) in zip(exact, signs, strict=True)]
            worst[lag] = np.maximum(worst[lag], errors)
            last = (craft.free, tables.held) if lag == 0 else (craft.F, tables.loop)
            e, gap = last[0] * e, [summed(0.0, row, gap, precision) for row in last[1]]
            if lag == 0:
                e += craft.held_map * feed
                pairs = zip(gap, tables.force, strict=True)
                gap = [summed(one, row, tables.feed[cell], precision) for one, row in pairs]
    assert (worst <= loss).all()
    ratio = loss.max(axis=1) / worst.max(axis=1)
    print(f"{precision}: bound over error {loss.max() / worst.max():.3g}, by node at most {ratio.max():.3g}")
    assert max(loss.max() / worst.max(), ratio.max()) <= 100


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("share * above", "2 * above"),
        ("good = 0;", "good = 1;"),
        ("->lost = 1", "->lost = 0"),
        (" | ", " & "),
    ],
)
def test_an_altered_text_is_refused(flown, tmp_path, old, new):
    for path in (flown / "double").glob("*.[ch]"):
        text = path.read_text()
        at = text.find("static int32_t kept(")
        changed = text[:at] + text[at:].replace(old, new, 1) if at > 0 else text
        (tmp_path / path.name).write_text(changed)
    verdict = verify(flown / "run", tmp_path)
    assert (verdict.outcome, verdict.claim) == ("REJECTED", "code")


@pytest.mark.parametrize("seed", [1, 4, 6])
def test_monitors_of_random_scenes_are_confirmed(tmp_path, seed):
    (tmp_path / "scene.toml").write_text(random_scenario(seed))
    folder = run(tmp_path / "scene.toml", tmp_path / "run", overrides=["simulation.runs=2"])
    for precision in PRECISIONS:
        export_c(folder.path, tmp_path / precision, precision, monitor=True)
        verdict = verify(folder.path, tmp_path / precision)
        assert verdict.outcome == "VERIFIED" and "monitor" in dict(verdict.checked), verdict.witness


def test_the_verbs_export_and_verify(flown, tmp_path):
    folder, out = str(flown / "run"), str(tmp_path / "code")
    done = CliRunner().invoke(app, ["export", "c", folder, "--out", out, "--prefix", "demo", "--monitor"])
    assert done.exit_code == 0, done.output
    done = CliRunner().invoke(app, ["verify", folder, "--code", out])
    assert done.exit_code == 0 and "S can take over wherever U may fly" in done.stdout


LOOSE = "feedback.period_s=0.25", "tracking.R=[60,60]", "system.disturbance_max=0.005"
MODELLED = {
    "errors of estimates and thrusters": ("estimate", "magnitude", "mass"),
    "constant errors of thrusters": ("constant magnitude", "bit"),
    "phases and missed measurements": ("phases", "missed periods", "magnitude"),
    "a delay, and thrusters": ("delay", "magnitude", "estimate"),
    "a delay that is no period": ("part of a period", "constant magnitude", "bias"),
}


def declared(names):
    return [*LOOSE, *(text for name in names for text in SOURCES[name])]


@pytest.mark.parametrize("names", MODELLED.values(), ids=MODELLED)
def test_errors_of_all_kinds_and_loops_that_remember_are_flown(tmp_path, names):
    """Confirmed in both precisions, and flown with these errors and under attack."""
    folder = make(declared(names), tmp_path)
    for precision in PRECISIONS:
        export_c(folder, tmp_path / precision, precision, monitor=True)
        verdict = verify(folder, tmp_path / precision)
        assert verdict.outcome == "VERIFIED" and "monitor" in dict(verdict.checked), verdict.witness
        schedule, code = read_schedule(folder), FlightCode(tmp_path / precision)
        assert falsify(schedule, 100, 1, code=code).failure is None
        runs = simulate(schedule, n=60, seed=4, tail=True, mode=1, code=code)
        assert runs.metrics().summary()["collided_runs"] == 0
        assert {mode for mode, _ in code.answers} == {0, 1}
        assert not any(fault & CLIPPED for mode, fault in code.answers if mode == 0)
        ground, rng = MonitorOnBoard(DecisionGrid.from_schedule(schedule), code), np.random.default_rng(2)
        spread = np.array(code.tables.apart) / 4
        for k in range(ground.grid.decisions):  # never bolder than `Monitor`
            state = ground.grid.xi[k] + rng.uniform(-1, 1, len(spread)) * spread
            assert ground.explained(k, state, 1)[0] <= ground.monitor.explained(k, state, 1)[0]


LESS = {
    "of thrusters": (("phases", "magnitude"), [*declared(["phases"]), "thrusters.magnitude_error=0.01"]),
    "in one phase": (("phases", "magnitude"), declared(["magnitude"])),
    "without a delay": (("delay", "estimate"), declared(["estimate"])),
}


@pytest.mark.parametrize("label", LESS)
def test_errors_that_are_not_booked_are_refused(tmp_path, label):
    """Tables of a scene whose errors are less, in the code of a run with more."""
    names, less = LESS[label]
    export_c(make(declared(names), tmp_path), tmp_path / "double", monitor=True)
    (tmp_path / "other").mkdir()
    export_c(make(less, tmp_path / "other"), tmp_path / "other" / "code", monitor=True)
    _, tables, _ = read_code(tmp_path / "other" / "code")
    changes = {name: getattr(tables, name) for name in ONLINE_SHAPES} | {"facets": tables.facets}
    verdict = forged(tmp_path, tmp_path / "forged", lambda t: changes)
    assert (verdict.outcome, verdict.claim) == ("REJECTED", "monitor") and "is booked" in verdict.witness


def test_what_a_loop_remembers_is_bounded_at_all_nodes():
    """A line of additions and a state that fades, from any start in the box; what grows has no bound."""
    rng, n = np.random.default_rng(3), 2
    for _ in range(20):
        free = np.triu(rng.normal(size=(5, 5)))
        free[2:, 2:] = np.diag([0.0, 0.0, rng.uniform(-0.9, 0.9)]) + np.diag(rng.normal(size=2), -1)
        added, box = rng.uniform(0, 1, 3), rng.uniform(0, 2, 3)
        bound = remembered(matrix(free.tolist()), n, [*map(flint.arb, added)], [*map(flint.arb, box)])
        bound = np.array([float(x.lower()) for x in bound])
        y = box * rng.choice([-1, 1], (200, 3))
        for _ in range(12):
            assert (np.abs(y) <= bound).all()
            y = y @ free[2:, 2:].T + added * rng.choice([-1, 1], y.shape)
        free[4, 4] = 1.1
        with pytest.raises(Rejected, match="no box holds"):
            remembered(matrix(free.tolist()), n, [flint.arb(1)] * 3, [flint.arb(1)] * 3)
        free[4, 4], free[3, 1] = 0.0, 1e-9
        with pytest.raises(Rejected, match="depends on the error"):
            remembered(matrix(free.tolist()), n, [flint.arb(1)] * 3, [flint.arb(1)] * 3)


@pytest.mark.parametrize(
    "names", ["camera", "jitter", "carried bit", "pulses", "fault", "outage", "phases, delay"]
)
def test_scenes_that_the_monitor_does_not_model_are_refused(tmp_path, names):
    folder = make(declared(names.split(", ")), tmp_path)
    with pytest.raises(ScenarioError, match="must be off with an observer, late"):
        export_c(folder, tmp_path / "code", monitor=True)
