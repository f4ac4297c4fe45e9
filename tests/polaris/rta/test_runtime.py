"""The runtime of the online monitor, rule by rule."""

import contextlib
import io
import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polaris.model.craft import Craft
from polaris.model.errors import ScenarioError
from polaris.rta.decision_grid import DecisionGrid
from polaris.rta.methods.monitor import Monitor
from polaris.rta.online.decision_log import DecisionLog, jsonable, read_log, restored
from polaris.rta.online.estimate import BoxFilter, BoxMotion, Measurement
from polaris.rta.online.runtime import OnlineMonitor, replay_log
from polaris.rta.online.runtime_options import RuntimeOptions
from reach.numerics.linear import discretize
from tests.kept import printed, scheduled
from tests.polaris import tiny

PATIENT = {"deadline": 1e3, "budget": 1e3}
HALF = 0.01


@cache
def monitor(latency=0.0, trust="thrust_limits", half=HALF):
    """The bundled scenario ``static``: 1800 decisions, one per second."""
    return Monitor(DecisionGrid.from_schedule(_static(), 1.0, latency, half), trust)


def _static():
    return printed("static", "feedback.period_s=1.0")[1]


class Flight:
    """The undisturbed reference, on which U is always welcome, and a runtime that is told about it."""

    def __init__(self, mon=None, log=None, timer=lambda: 0.0, **options):
        self.mon = mon or monitor()
        self.online = OnlineMonitor(self.mon, RuntimeOptions(**{**PATIENT, **options}), log, timer)
        self.grid = self.mon.grid

    def at(self, k):
        return self.grid.xi[k * self.grid.nodes].copy()

    def honest(self, k, **changed):
        data = {"stamp": k * self.grid.period, "state": self.at(k), **changed}
        return Measurement(**data)

    def step(self, k, measurement="honest", now=None, **options):
        measured = self.honest(k) if measurement == "honest" else measurement
        return self.online.step(k * self.grid.period if now is None else now, measured, **options)

    def steps(self, first, last):
        return [self.step(k) for k in range(first, last)]


def families(answer):
    return {fault.family for fault in answer.faults}


def test_honest_measurements_let_u_fly_with_the_monitors_own_answer():
    flight = Flight()
    for answer in flight.steps(0, 20):
        mode, margin = flight.mon.judge_one(answer.k, np.zeros(6), 1)
        assert (answer.mode, answer.margin, answer.faults) == (mode, margin, ()) and mode == 1
        assert answer.until == (answer.k + 1) * flight.grid.period
        assert answer.reason.startswith("nearest limit: ")
        assert " at t = " in answer.reason or "beyond the settling horizon" in answer.reason


BAD = {
    "missing": lambda f, k: None,
    "malformed: not a measurement": lambda f, k: (k, f.at(k)),
    "malformed: the stamp": lambda f, k: f.honest(k, stamp="noon"),
    "malformed: the state": lambda f, k: f.honest(k, state=f.at(k)[:5]),
    "malformed: the half widths": lambda f, k: f.honest(k, half_widths="wide"),
    "the stamp is not finite": lambda f, k: f.honest(k, stamp=np.nan),
    "the state is not finite": lambda f, k: f.honest(k, state=f.at(k) + [0, 0, 0, np.nan, 0, 0]),
    "absurd": lambda f, k: f.honest(k, state=f.at(k) + 1e7),
    "future": lambda f, k: f.honest(k, stamp=k + 0.5),
    "stale": lambda f, k: f.honest(k, stamp=k - 1.5, state=f.at(k)),
    "duplicated": lambda f, k: f.honest(k - 1),
    "reordered": lambda f, k: f.honest(k - 2),
    "frozen": lambda f, k: f.honest(k, state=f.at(k - 1)),
    "late": lambda f, k: f.honest(k, stamp=k - 0.5, state=(f.at(k - 1) + f.at(k)) / 2),
    "half widths": lambda f, k: f.honest(k, half_widths=np.full(6, 2 * HALF)),
}


@pytest.mark.parametrize("kind", BAD)
def test_a_bad_measurement_means_s_and_says_why(kind):
    flight = Flight(max_age=1.2)
    flight.steps(0, 4)
    flight.step(4, None if kind == "stale" else "honest")
    answer = flight.step(5, BAD[kind](flight, 5))
    assert answer.mode == 0 and answer.until == -np.inf
    assert answer.reason.startswith(f"measurement: {kind}")
    last = [flight.step(k) for k in range(6, 10)][-1]
    assert last.mode == 1 and not last.faults  # one bad measurement is forgiven


def test_a_delayed_measurement_is_used_if_the_state_is_still_known_well_enough():
    flight = Flight(monitor(half=0.1))
    flight.step(0)
    for k, half, mode in ((1, 1e-4, 1), (2, 0.09, 0)):
        before = flight.at(k) - 0.25 * (flight.at(k) - flight.at(k - 1))  # near the state 0.25 s earlier
        measured = flight.honest(k, stamp=k - 0.25, state=before, half_widths=np.full(6, half))
        answer = flight.step(k, measured)
        assert answer.mode == mode and (mode or answer.reason.startswith("measurement: late")), answer


def test_a_jump_means_s_until_enough_measurements_agree():
    flight = Flight(reacquire=3)
    first = Flight().step(0, flight.honest(0, state=flight.at(0) + 20.0))
    assert first.reason.startswith("estimate: conflict: "), "with the initial set"
    flight.steps(0, 5)
    answer = flight.step(5, flight.honest(5, state=flight.at(5) + [0, 5.0, 0, 0, 0, 0]))
    assert answer.mode == 0 and answer.reason.startswith("estimate: conflict: ")
    assert [a.mode for a in flight.steps(6, 10)] == [0, 0, 1, 1]  # 1, 2 and 3 agree


def test_after_a_long_silence_measurements_must_agree_again():
    flight = Flight(memory=4.0, reacquire=2)
    flight.steps(0, 3)
    assert [flight.step(k, None).mode for k in range(3, 9)] == [0] * 6
    answers = flight.steps(9, 12)
    assert answers[0].reason.startswith("estimate: nothing to compare with")
    assert [a.mode for a in answers] == [0, 1, 1]


@pytest.mark.parametrize("by", [-3.0, -0.2, 0.2, 1.0, 2.5, 1e9])
@pytest.mark.parametrize("clocks", [1, 2])
def test_a_clock_that_was_set_is_not_believed_until_told(by, clocks):
    flight = Flight()
    second = (lambda k: {"reference": 1e6 + k}) if clocks == 2 else (lambda k: {})
    for k in range(5):
        flight.step(k, **second(k))
    for k in range(5, 15):
        answer = flight.step(k, now=k + by, **second(k))
        assert answer.mode == 0 and families(answer) >= {"clock"}
    flight.online.resynchronise(15.0)  # the clock has been set right
    flight.online.step(15.0, flight.honest(15), **second(15))
    assert [flight.step(k, **second(k)).mode for k in (16, 17, 18)][-1] == 1


def test_missed_decisions_are_forgiven_with_a_second_clock_or_a_number():
    flights = Flight(), Flight(), Flight()
    for k in (0, 1, 2, 5, 6, 7):
        alone, both, counted = (
            flight.step(k, **clocks)
            for flight, clocks in zip(flights, ({}, {"reference": 100.0 + k}, {"number": k}), strict=True)
        )
        assert both.mode == counted.mode == 1  # after the missed ones at once
        assert [fault.family for fault in counted.faults] == ["missed"] * (k == 5)
    assert alone.reason == "clock: the reading is 2 s ahead of the number of calls"
    late = Flight(monitor(latency=1.0))  # by which calls may be late
    assert [late.step(k, now=k + 0.3, reference=k + 0.3).mode for k in range(4)][-1] == 1
    ending, end = Flight(), flights[0].grid.decisions
    answers = [ending.step(k, reference=float(k)) for k in range(end - 5, end + 2)]
    assert answers[-2].reason == "the plan has ended" and answers[-1].mode == 0


def test_s_keeps_control_for_its_dwell_of_which_missed_decisions_are_part():
    flight = Flight(min_dwell=4)
    flight.steps(0, 3)
    flight.step(3, None)
    answers = flight.steps(4, 9)
    assert [a.mode for a in answers] == [0, 0, 0, 1, 1]
    assert answers[0].reason == "rule: dwell: 1 of 4 decisions in S" and answers[0].margin > 0
    flight = Flight(min_dwell=4)
    flight.step(0, number=0)
    assert [flight.step(k, number=k).mode for k in (3, 4, 5)] == [0, 0, 1]  # S had 1 to 4


def test_a_number_is_a_second_opinion():
    flight = Flight()
    flight.step(0, number=0)
    wrong = flight.step(1, number=2)
    assert (wrong.mode, wrong.reason) == (0, "clock: the reading is 1 s behind the decision's number")
    assert flight.step(2, number=2).mode == 1  # they agree again
    assert flight.step(3, number=3.5).reason == "clock: the decision's number is not a whole number"
    assert flight.step(6, number=6).mode == 1
    set_ahead = [flight.step(k, now=k + 3.0, number=k) for k in range(7, 12)]
    assert {a.mode for a in set_ahead} == {0}
    flight.online.resynchronise(15.0)  # it was right, and the counter wrong
    assert flight.step(15, number=12).mode == 1 and flight.step(16, number=13).mode == 1
    both = Flight()
    answers = [both.step(k, number=k + (k == 3), reference=50.0 + k) for k in range(5)]
    assert [a.mode for a in answers] == [1, 1, 1, 0, 1]
    assert answers[3].reason == "clock: called for decision 4 at decision 3"


@pytest.mark.parametrize("off", [-1.0, -0.3, 0.3])
def test_calls_off_the_grid_or_twice(off):
    flight = Flight()
    for k in range(3):
        flight.step(k, reference=float(k))
    answer = flight.step(3, now=3 + off, reference=3 + off)
    called = "clock: called again for decision 2" if off == -1 else "clock: called "
    assert answer.mode == 0 and answer.reason.startswith(called)


def test_a_second_clock_that_drifts_away_is_noticed_however_slowly():
    flight = Flight(drift=0.01)
    reasons = [flight.step(k, reference=1.001 * k).reason for k in range(20)]
    assert "clock" not in "".join(reasons[:10]) and "second clock" in reasons[12]


def test_faults_of_u_mean_s_from_the_next_decision_and_latch():
    flight = Flight(latch=4, budget=5.0)
    command, limit = flight.online.command, flight.grid.system.u_max
    np.testing.assert_array_equal(command(lambda x: 10 * x, limit), limit)  # clipped, as by the thrusters
    flight.step(0)
    faulty = {
        "raised ZeroDivisionError": lambda: 1 / 0,
        "malformed": lambda: [0.0],
        "not finite": lambda: limit * np.nan,
    }
    for k, (text, law) in enumerate(faulty.items(), start=1):
        assert command(law) is None
        answer = flight.step(2 * k - 1)
        assert answer.mode == 0 and answer.reason.startswith("controller: ") and text in answer.reason
        assert flight.step(2 * k).mode == 1
    timer = flight.online._timer
    for ticks, accepted in (([0.0, 0.0], True), ([0.0, 6.0], False)):
        flight.online._timer = iter(ticks).__next__
        assert (command(lambda: limit) is not None) == accepted
    flight.online._timer = timer
    assert flight.step(7).reason == "controller: over its time budget"
    assert {a.mode for a in flight.steps(8, 60)} == {0}
    assert flight.step(60).reason == "rule: latched: 4 faults of U or of the monitor"


def test_the_monitors_own_exceptions_and_deadline_mean_s(monkeypatch):
    clock = [0.0]
    flight = Flight(timer=lambda: clock[0], deadline=0.5, latch=None)
    flight.steps(0, 2)
    explained = flight.mon.explained

    def slow(*arguments):
        clock[0] += 0.6
        return explained(*arguments)

    monkeypatch.setattr(flight.mon, "explained", slow)
    assert flight.step(2).reason == "monitor: deadline missed"
    monkeypatch.setattr(flight.mon, "explained", lambda *arguments: 1 / 0)
    answer = flight.step(3)
    assert (answer.mode, answer.reason) == (0, "monitor: raised ZeroDivisionError")
    monkeypatch.undo()
    assert flight.step(4).mode == 1
    late = Flight(monitor(latency=1.0), timer=iter([0.0, 0.8, 1.0, 1.8]).__next__)
    assert late.step(0, now=0.1).mode == 1
    assert late.step(1, now=1.3).reason == "monitor: deadline missed", "after the moment of effect"


def test_conflicts_in_a_row_latch():
    flight = Flight(latch_conflicts=2)
    for k in range(20):  # the one at 3 is forgiven, three have agreed since; 10 and 12 are in a row
        flight.step(k, flight.honest(k, state=flight.at(k) + [0, 5.0 * (k in (3, 10, 12)), 0, 0, 0, 0]))
        assert k != 9 or not flight.online.observer.conflicts
    assert flight.step(20).reason == "rule: latched: 2 conflicts between measurements"


@pytest.mark.parametrize(
    "wrong",
    [
        {"max_age": -1.0},
        {"reacquire": 0},
        {"latch": 0},
        {"deadline": np.nan},
        {"min_dwell": 1.5},
        {"tolerance": 0.7},
    ],
)
def test_options_are_checked(wrong):
    with pytest.raises(ScenarioError, match="half the period" if "tolerance" in wrong else None):
        OnlineMonitor(monitor(), RuntimeOptions(**wrong))


def story(stream=None):
    """A flight with some of everything; its log and answers."""
    out = stream or io.StringIO()
    flight = Flight(log=DecisionLog(out))
    answers = flight.steps(0, 3)
    answers.append(flight.step(3, flight.honest(3, state=flight.at(3) * np.nan)))
    answers.append(flight.step(4, flight.honest(4, state=flight.at(4) + 3.0)))
    answers.append(flight.step(5, flight.honest(5, state={"x": 1}, half_widths=np.full(6, np.inf))))
    flight.online.command(lambda: 1 / 0)
    answers.append(flight.step(6, applied=np.zeros(3)))
    answers.append(flight.step(7, now=np.inf))
    answers.append(flight.step(8, now=80.0, applied=np.array([[-np.nan, 0, 0], [0, 0, 0]])))
    flight.online.resynchronise(9.0)
    answers += flight.steps(9, 14)
    return out, answers


def test_lines_are_strict_json_and_tell_the_story():
    out, answers = story()
    assert out.getvalue() == story()[0].getvalue()  # deterministic, byte for byte

    def refuse(name):
        raise AssertionError(name)

    lines = [json.loads(line, parse_constant=refuse) for line in out.getvalue().splitlines()]
    assert [line["mode"] for line in lines] == [a.mode for a in answers]
    assert [line["reason"] for line in lines] == [a.reason for a in answers]
    assert lines[3]["measurement"]["state"] == ["nan"] * 6 and lines[3]["margin"] == "nan"
    assert lines[5]["measurement"]["state"] == {"unreadable": "dict"}
    assert lines[6]["controller"] == ["raised ZeroDivisionError"] and lines[7]["now"] == "inf"
    assert lines[9]["resynchronised"] == 9.0 and lines[-1]["mode"] == 1


def test_replay_gives_the_same_decisions(tmp_path):
    with open(tmp_path / "log.jsonl", "w", encoding="utf-8") as stream:
        _, answers = story(stream)
        stream.write('{"k": 14, "mo')  # cut short by a crash
    replayed = replay_log(read_log(tmp_path / "log.jsonl"), monitor(), RuntimeOptions(**PATIENT))
    assert [repr(a) for a in replayed] == [repr(a) for a in answers]
    ticks = iter([0.0, 0.0, 0.0, 9.0, 9.0, 9.0, 9.0, 9.0])
    with DecisionLog(tmp_path / "late.jsonl") as log:
        answers = Flight(log=log, timer=lambda: next(ticks), deadline=1.0).steps(0, 4)
    assert [a.mode for a in answers] == [1, 0, 1, 1], "one missed its deadline"
    replayed = replay_log(read_log(tmp_path / "late.jsonl"), monitor(), RuntimeOptions(deadline=1.0))
    assert [repr(a) for a in replayed] == [repr(a) for a in answers]


def test_a_log_goes_on_in_further_files_and_replays(tmp_path):
    """With a limit per file and none on their number, nothing is lost."""
    path = tmp_path / "log.jsonl"
    with DecisionLog(path, max_bytes=1500) as log:
        answers = Flight(log=log).steps(0, 12)
    files = sorted(tmp_path.iterdir())
    assert [file.name for file in files[:3]] == ["log.jsonl", "log.jsonl.1", "log.jsonl.2"]
    longest = max(len(line) + 1 for file in files for line in file.read_text().splitlines())
    assert all(file.stat().st_size <= max(1500, longest) for file in files)
    replayed = replay_log(read_log(path), monitor(), RuntimeOptions(**PATIENT))
    assert [repr(a) for a in replayed] == [repr(a) for a in answers]
    (tmp_path / "log.jsonl.1").unlink()
    with pytest.raises(ScenarioError, match="some of its files are missing"):
        read_log(path)
    path = tmp_path / "bad.jsonl"
    path.write_text("[1]\n", encoding="utf-8")
    with pytest.raises(ScenarioError, match="new file"):
        DecisionLog(path)
    with pytest.raises(ScenarioError, match="line 1"):
        read_log(path)
    full = io.StringIO()
    full.write = lambda text: 1 / 0
    answers = Flight(log=DecisionLog(full)).steps(0, 3)
    assert [(a.mode, families(a)) for a in answers] == [(1, set()), (1, {"log"}), (1, {"log"})]


def test_a_log_keeps_so_many_files_and_deletes_only_its_own(tmp_path):
    path = tmp_path / "log.jsonl"
    with DecisionLog(path, max_bytes=30, max_files=3) as log:
        for k in range(40):
            if k == 20:
                path.with_name(f"log.jsonl.{k - 2}").write_text('{"of": "the user"}\n', encoding="utf-8")
            log.write({"k": k, "padding": "x" * 10})
    names = {"log.jsonl.18", "log.jsonl.37", "log.jsonl.38", "log.jsonl.39"}
    assert {file.name for file in tmp_path.iterdir()} == names, "one line in each"
    assert sum(file.stat().st_size for file in tmp_path.iterdir()) < 4 * 40
    with pytest.raises(ScenarioError, match="missing"):
        read_log(path)
    assert [line.get("k") for line in read_log(path, partial=True)] == [None, 37, 38, 39]
    with pytest.raises(ScenarioError, match="new file"):
        DecisionLog(path)  # its later files are there
    for wrong in ({"max_files": 2}, {"max_bytes": 0}, {"max_bytes": 9, "max_files": 1}):
        with pytest.raises(ScenarioError):
            DecisionLog(tmp_path / "other", **wrong)
    with pytest.raises(ScenarioError):
        DecisionLog(io.StringIO(), max_bytes=9)
    assert not (tmp_path / "other").exists()


ROWS = st.lists(st.tuples(st.floats(), st.floats()).map(list), min_size=1, max_size=2)


@given(st.floats() | st.lists(st.floats(), max_size=9) | ROWS)
def test_plain_values_survive(value):
    text = json.dumps(jsonable(value), allow_nan=False)
    assert repr(restored(json.loads(text))) == repr(value)


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(1, 4), st.booleans(), st.booleans())
def test_the_box_always_contains_the_true_state(seed, n, bounded, exact):
    """Any stable or unstable motion, inputs held for parts of a period, missed and delayed measurements."""
    rng = np.random.default_rng(seed)
    A, B, D = rng.normal(size=(n, n)), rng.normal(size=(n, 2)), rng.normal(size=(n, 1))
    system = Craft(A, B, D, rng.uniform(0.1, 1, 2), rng.uniform(0, 0.3), C=np.eye(n)[:1])
    half = np.zeros(n) if exact else rng.uniform(0, 0.2, n)
    box = BoxFilter(BoxMotion(system, 0.2, 1.0), -np.ones(n), np.ones(n))
    x, t, parts = rng.uniform(-1, 1, n), 0.0, 4
    Ad, BDd = discretize(A, np.hstack([B, D]), 0.2 / parts)
    for k in range(20):
        pushes = rng.uniform(-1, 1, (parts, 2)) * system.u_max
        reset = box.t >= t - 1e-12  # from now on the box depends on these inputs alone
        box.note_commands(np.array([pushes.min(axis=0), pushes.max(axis=0)]) if bounded else None, reset)
        measured = rng.random() < 0.8 or k - box.t / 0.2 > 3
        stamp = int(rng.integers(1, parts + 1)) if measured else 0
        for part in range(parts):
            w = rng.choice([-1, 1]) * system.w_max
            x = Ad @ x + BDd @ [*pushes[part], w]
            t = k * 0.2 + 0.2 * (part + 1) / parts
            if part + 1 == stamp:
                y = x + rng.uniform(-1, 1, n) * half * (1 - 1e-12)
                assert box.cut(t, y, half) < 0
                slack = 1e-13 * (1 + np.abs(x))
                assert (box.low <= x + slack).all() and (x <= box.high + slack).all()
                assert (box.high <= y + half + slack).all() and (box.low >= y - half - slack).all()
        predicted = box.propagated(t)
        assert (-predicted[n:] <= x).all() and (x <= predicted[:n]).all()
    fast = Craft(np.eye(1) * 50, np.ones((1, 1)), np.ones((1, 1)), np.ones(1))
    with pytest.raises(ScenarioError, match="memory"):
        BoxMotion(fast, 1.0, 10.0)


@pytest.mark.parametrize(("period", "latency"), [(1 / 9, 0.0), (1 / 3, 1 / 9)])
@pytest.mark.parametrize("trust", ["declared", "thrust_limits"])
def test_one_error_is_judged_as_many_are(period, latency, trust):
    schedule = tiny.synthesised()[1]
    mon = Monitor(
        DecisionGrid.from_schedule(schedule, period=period, latency=latency, half_widths=0.002), trust
    )
    rng, spread = np.random.default_rng(0), mon.grid.tracking.W_inverse.T
    all_modes = set()
    for k in range(0, mon.grid.decisions, 3):
        e = rng.normal(size=(12, 4)) @ spread * rng.choice([0.02, 0.3], (12, 1))
        flying = rng.integers(0, 2, 12)
        modes, _ = mon.judge(k, e, flying)
        for one, before, expected in zip(e, flying.tolist(), modes.tolist(), strict=True):
            state = one + mon.grid.xi[k * mon.grid.nodes]
            mode, margin, limit = mon.explained(k, state, before)
            share = mon._share(k, one[None], 1, before if latency else 0)[0]
            assert mode == expected and limit
            assert margin == pytest.approx(1 - share, rel=1e-12, abs=1e-12)
            all_modes.add(mode)
    assert 0 in all_modes and (1 in all_modes or trust == "thrust_limits")


def test_the_example_of_the_page_runs(tmp_path, monkeypatch):
    page = (Path(__file__).parents[3] / "docs" / "online-monitor.md").read_text(encoding="utf-8")
    code = [part.split("```")[0] for part in page.split("```python\n")[1:]]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("polaris.synthesize", lambda scenario: scheduled(scenario.name)[1])
    namespace, out = {}, io.StringIO()
    with contextlib.redirect_stdout(out):
        for block in code:
            exec(compile(block, "online-monitor.md", "exec"), namespace)
    outputs = [part.split("```")[0] for part in page.split("```text\n")[1:]]
    assert out.getvalue().split() == "".join(outputs).split()
