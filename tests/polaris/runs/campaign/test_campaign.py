"""Campaigns in this process and in a pool: the same table, resumed, repaired, extended; cases that fail."""

import json
import os
import signal
import subprocess
import sys
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from itertools import product
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from polaris.model.errors import PolarisError, ScenarioError
from polaris.planning.effort import SearchEffort
from polaris.runs.campaign import Interrupted, Workers, batch, local, make_cases, read_campaign, schedules
from polaris.scenario.scenario import load_scenario
from polaris.simulation.metrics import violation_interval
from polaris.simulation.run_metrics import evaluate
from polaris.simulation.simulate import simulate
from polaris.synthesis.schedule.synthesize import synthesize
from tests.leftovers import left_by_a_dead_process
from tests.polaris.runs.campaign import scene
from tests.polaris.runs.campaign.scene import GRID, MODES, RUNS, TINY, cases, fly, rows, run, table

ROOT = Path(__file__).parents[4]


def test_table_has_one_row_per_run_with_everything_that_was_measured(flown):
    lines = rows(flown.path)
    assert len(lines) == 2 * 2 * RUNS
    keys = {(row["case"], row["batch"], row["run"], row["mode"]) for row in lines}
    assert len(keys) == len(lines)
    seeds = {(row["case"], row["batch"]): (row["seed"], row["seed_truth"]) for row in lines}
    assert len(set(seeds.values())) == len(seeds), "every batch draws its own"
    for margin, mode in ((0.3, "polaris"), (0.4, "experimental")):
        selected = [row for row in lines if row["planner.extra_margin_m"] == margin and row["mode"] == mode]
        assert len(selected) == RUNS and {row["scenario"] for row in selected} == {"tiny"}
    # a batch is what `simulate` and `evaluate` give for the seeds in its rows
    first = [row for row in lines if (row["case"], row["batch"], row["mode"]) == (1, 2, "polaris")]
    schedule = synthesize(load_scenario(TINY).set("planner.extra_margin_m", 0.4))
    columns = evaluate(simulate(schedule, 5, first[0]["seed"]), first[0]["seed_truth"]).columns()
    assert set(columns) <= set(first[0])
    for name, values in columns.items():
        np.testing.assert_array_equal([row[name] for row in first], values)


def test_summary_is_that_of_the_table(flown):
    lines, summary = rows(flown.path), flown.summary
    assert summary["flown"] == len(lines) and summary["runs"] == RUNS
    assert summary["disturbance"] == "failing" and "this mixture, not to real" in summary["assumptions"][0]
    for case, mode in product(summary["cases"], MODES):
        selected = [row for row in lines if row["case"] == case["case"] and row["mode"] == mode]
        entry, hits = case["modes"][mode], sum(row["collided"] for row in selected)
        assert entry["violations"] == hits == (RUNS if mode == "experimental" else 0)
        chance = entry["violation_probability"]
        assert (chance["low"], chance["high"]) == violation_interval(hits, RUNS)
        delta_v = np.array([row["delta_v_m_s"] for row in selected])
        assert entry["mean"]["delta_v_m_s"]["mean"] == pytest.approx(delta_v.mean(), rel=1e-12)
        assert entry["worst"]["delta_v_m_s"] == delta_v.max()
        for name in ("max_thrust_ratio", "max_thrust_ratio_safety", "switches"):
            largest = max(row[name] for row in selected)  # of S's thrust where S never flies: no number
            assert entry["worst"][name] == (None if np.isnan(largest) else largest), name
        for name in ("min_distance_m", "experimental_share"):
            assert entry["worst"][name] == min(row[name] for row in selected), name
        nearest = sorted((row["min_distance_m"], row["batch"], row["run"]) for row in selected)[:5]
        assert [(row["min_distance_m"], row["batch"], row["run"]) for row in entry["worst_runs"]] == nearest


def test_executor_and_order_do_not_change_a_bit(flown, tmp_path):
    backwards = Lazy()
    assert table(fly(tmp_path / "backwards", Workers(lambda: backwards, lambda: 5)).path) == table(flown.path)
    assert backwards.order[:5] == [(0, batch) for batch in (4, 3, 2, 1, 0)]
    assert backwards.most == 5, "few tasks are handed out at a time"
    with ThreadPoolExecutor(3) as threads:
        assert table(fly(tmp_path / "threads", threads).path) == table(flown.path)
        assert threads.submit(int).result() == 0, "somebody else's executor is not closed"


def test_a_campaign_needs_no_optional_package(flown, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    bare = fly(tmp_path / "c")
    assert bare.table == "npz" and bare.summary["cases"] == flown.summary["cases"]
    before, names = table(bare.path), [name.replace(".parquet", ".npz") for name in table(flown.path)]
    assert table(fly(tmp_path / "c").path) == before and list(before) == names
    monkeypatch.undo()
    for case in (0, 1):
        np.testing.assert_equal(read_campaign(bare.path).read(case), flown.read(case))


@pytest.mark.slow
def test_a_pool_gives_the_same_table(flown, tmp_path):
    assert table(fly(tmp_path / "c", local(2)).path) == table(flown.path)


class Lazy(Executor):
    """Does nothing until five tasks wait, and then the last one first."""

    def __init__(self):
        self.waiting, self.most, self.order = [], 0, []

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        self.waiting.append((future, fn, args))
        self.most = max(self.most, len(self.waiting))
        if len(self.waiting) == 5:
            for one, call, (task,) in reversed(self.waiting):
                self.order.append((task.case, task.batch))
                one.set_result(call(task))
            self.waiting.clear()
        return future


def test_finished_parts_are_not_flown_again(flown, copied, seen):
    (copied / "runs" / "case-0001-batch-00002.parquet").unlink()
    remnant = left_by_a_dead_process(copied / "runs")
    fly(copied)
    assert seen == [(1, 2)] and table(copied) == table(flown.path) and not remnant.exists()
    fly(copied)
    assert seen == [(1, 2)]


@pytest.mark.parametrize("kind", ["empty", "cut", "number", "footer"])
def test_damaged_parts_are_flown_again(flown, copied, seen, kind):
    part = copied / "runs" / "case-0000-batch-00003.parquet"
    part.write_bytes(damage(part.read_bytes(), kind))
    damaged = part.read_bytes()
    fly(copied)
    assert seen == [(0, 3)] and table(copied) == table(flown.path)
    assert (copied / f"{part.name}.kept").read_bytes() == damaged, "whoever changed it"


def test_a_part_of_elsewhere_is_flown_again(flown, copied, tmp_path, seen):
    other = fly(tmp_path / "d", seed=8).path
    seen.clear()
    name = "runs/case-000{}-batch-0000{}.parquet".format
    (copied / name(0, 1)).write_bytes((other / name(0, 1)).read_bytes())
    (copied / name(1, 0)).write_bytes((copied / name(1, 1)).read_bytes())
    fly(copied)
    assert seen == [(0, 1), (1, 0)] and table(copied) == table(flown.path)


def test_more_runs_extend_a_campaign_and_fewer_are_refused(flown, tmp_path, seen):
    options = {"batch": 5, "modes": MODES, "seed": 7}
    out = run(cases(), 13, tmp_path / "c", **options).path
    seen.clear()
    assert run(cases(), RUNS, out, **options).summary["runs"] == RUNS
    assert seen == [(case, number) for case in (0, 1) for number in (2, 3, 4)]
    assert table(out) == table(flown.path)
    with pytest.raises(ScenarioError, match=f"must be at least {RUNS}"):
        run(cases(), 13, out, **options)


def test_a_pool_that_breaks_is_replaced_and_one_that_only_breaks_given_up(flown, tmp_path):
    created = []

    def pool():
        created.append(Breaking())
        return created[-1]

    assert table(fly(tmp_path / "b", Workers(pool, lambda: 3)).path) == table(flown.path)
    assert len(created) == 5
    pools = iter([2, 0, 0, 0, 0, 0])
    with pytest.raises(PolarisError, match="lost 4 times.*10 runs are kept in .*goes on from there"):
        fly(tmp_path / "c", Workers(lambda: Breaking(next(pools)), lambda: 3))
    assert len(table(tmp_path / "c")) == 2
    assert next(pools) == 0
    with pytest.raises(PolarisError, match="lost"):
        fly(tmp_path / "c", Breaking(1))
    assert len(table(tmp_path / "c")) == 3
    assert table(fly(tmp_path / "c").path) == table(flown.path)


def test_another_campaign_is_refused_unless_asked_to_be_replaced(tmp_path):
    out = tmp_path / "c"
    run(make_cases([TINY]), 3, out)
    with pytest.raises(ScenarioError, match=r"another campaign \(other seed\); --fresh"):
        run(make_cases([TINY]), 3, out, seed=1)
    with pytest.raises(ScenarioError, match=r"other cases"):
        run(make_cases([TINY], GRID), 3, out)
    assert run(make_cases([TINY]), 3, out, seed=1, fresh=True).plan.seed == 1
    assert {path.name for path in tmp_path.iterdir()} == {"c"}


def test_damaged_manifests_are_told(copied):
    manifest = copied / "manifest.json"
    data = json.loads(manifest.read_text(encoding="utf-8"))
    for changed, word in (
        ({**data, "seed": 5}, "digest does not fit"),
        ({**data, "version": "0.0.1"}, "version 0.0.1"),
        ({**data, "cases": 3}, "damaged"),
        ([], "damaged"),
    ):
        manifest.write_text(json.dumps(changed), encoding="utf-8")
        with pytest.raises(ScenarioError, match=word):
            read_campaign(copied)
    manifest.unlink()
    with pytest.raises(ScenarioError, match=r"no manifest\.json"):
        read_campaign(copied)


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_killed_campaign_leaves_whole_parts_and_goes_on(flown, tmp_path, workers):
    out = tmp_path / "c"
    code = f"from tests.polaris.runs.campaign.scene import fly, local; fly({str(out)!r}, local({workers}))"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    (tmp_path / "killed.py").write_text(f'if __name__ == "__main__":\n    {code}\n', encoding="utf-8")
    command = [sys.executable, str(tmp_path / "killed.py")]
    child = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE)
    try:
        scene.await_parts(out, 2, child)
    finally:
        child.send_signal(signal.SIGKILL)
        child.wait()
    parts = {path.name: path.read_bytes() for path in (out / "runs").glob("case-*.parquet")}
    expected = table(flown.path)
    assert len(parts) > 0 and parts.items() <= expected.items(), "parts are whole or absent"
    assert child.stdout is not None and child.stdout.read() == b"", "open while any of its processes lives"
    assert table(fly(out).path) == expected


class Breaking(Executor):
    """Breaks at its third task, as a pool does whose process is killed."""

    def __init__(self, sound=2):
        self.sound = sound

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        self.sound -= 1
        if self.sound >= 0:
            future.set_result(fn(*args, **kwargs))
        else:
            future.set_exception(BrokenProcessPool("a process in the pool was terminated"))
        return future


def test_interruption_keeps_what_is_finished_and_says_how_to_go_on(flown, tmp_path, monkeypatch):
    real = batch.fly_batch

    def fly_batch(task):
        if (task.case, task.batch) == (0, 3):
            raise KeyboardInterrupt
        return real(task)

    with monkeypatch.context() as patched:
        patched.setattr("polaris.runs.campaign.drive.fly_batch", fly_batch)
        with pytest.raises(Interrupted, match="interrupted; 15 runs are kept in .*the same command goes on"):
            fly(tmp_path / "c")
    assert len(table(tmp_path / "c")) == 3
    assert table(fly(tmp_path / "c").path) == table(flown.path)


def test_a_case_without_a_schedule_is_told_and_stops_nothing(tmp_path, seen):
    weak = make_cases([TINY], {"system.input_max": [0.02, 1.0]})
    folder = run(weak, 9, tmp_path / "c", batch=3)
    failed, proven = folder.summary["cases"]
    assert failed["exit_code"] == 3 and "To make it feasible" in failed["failure"] and "modes" not in failed
    assert proven["modes"]["polaris"]["runs"] == 9
    assert {row["case"] for row in rows(folder.path)} == {1}
    seen.clear()
    run(weak, 9, folder.path, batch=3)
    assert seen == [], "infeasible is infeasible"


def test_a_schedule_that_hangs_on_the_clock_is_not_flown(tmp_path, monkeypatch):
    """Another machine might fly another one."""
    with monkeypatch.context() as late:
        late.setattr(schedules, "_synthesize", schedules._synthesize.__wrapped__)  # others keep theirs
        struck = property(lambda self: ("fuel",) if self.search.rows.problem.unsafe else ())
        late.setattr(SearchEffort, "cut_by_clock", struck)
        summary = run(make_cases([TINY]), 3, tmp_path / "c").summary
    assert summary["flown"] == 0 and "raise planner.time_limit_s" in summary["cases"][0]["failure"]
    assert summary["cases"][0]["exit_code"] == 4
    assert run(make_cases([TINY]), 3, tmp_path / "c").summary["flown"] == 3, "tried again"


def test_schedules_that_differ_from_those_of_parts_kept_are_an_error(tmp_path, monkeypatch):
    out, real = run(make_cases([TINY]), 9, tmp_path / "c", batch=3).path, batch.fly_batch
    changed = "polaris.runs.campaign.drive.fly_batch"
    monkeypatch.setattr(changed, lambda task: batch.Batch("0" * 64, real(task).columns))
    (out / "runs" / "case-0000-batch-00001.parquet").unlink()
    with pytest.raises(PolarisError, match="different schedules.*6 runs are kept"):
        run(make_cases([TINY]), 9, out, batch=3)


def test_a_full_disk_names_the_path_keeps_the_parts_and_goes_on(flown, tmp_path, monkeypatch):
    out, real = tmp_path / "c", pq.write_table

    def write(table, path, **options):
        if len(list((out / "runs").glob("case-*.parquet"))) == 2:
            raise OSError(28, "No space left on device", str(path))
        real(table, path, **options)

    monkeypatch.setattr(pq, "write_table", write)
    pattern = r"c/runs.*No space left on device.*Free some space.* runs are kept in .*goes on"
    with pytest.raises(PolarisError, match=pattern):
        fly(out)
    assert table(out).items() < table(flown.path).items()
    assert not [path for path in out.rglob("*") if ".new-" in path.name]
    monkeypatch.setattr(pq, "write_table", real)
    assert table(fly(out).path) == table(flown.path)


def test_a_worker_of_another_version_refuses(flown, monkeypatch):
    task = flown.plan.task(0, 0)
    monkeypatch.setattr("polaris.runs.campaign.batch.version", lambda: "99.0")
    with pytest.raises(PolarisError, match=r"has Polaris 99\.0"):
        batch.fly_batch(task)


def damage(content, kind):
    """Content of a part that was cut, or in which a bit of a number or of the footer was turned."""
    content = bytearray(content)
    if kind == "number":
        group = pq.ParquetFile(pa.BufferReader(bytes(content))).metadata.row_group(0)
        columns = {group.column(i).path_in_schema: group.column(i) for i in range(group.num_columns)}
        column = columns["min_distance_m"]
        first = column.dictionary_page_offset or column.data_page_offset
        content[first + column.total_compressed_size - 1] ^= 4  # not of a page's header
    elif kind == "footer":
        content[-20] ^= 255
    return bytes(content[: {"empty": 0, "cut": len(content) // 2}.get(kind)])
