"""Campaigns in this process and in a pool: the same table, resumed, repaired, extended; cases that fail."""

import json
import os
import signal
import subprocess
import sys
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from polaris.model.errors import PolarisError, ScenarioError
from polaris.runs.campaign import Interrupted, Workers, batch, local, make_cases, read_campaign, schedules
from polaris.runs.files.atomic import replacing
from polaris.runs.files.ownership import MANIFEST
from polaris.scenario.scenario import load_scenario
from polaris.simulation.metrics import violation_interval
from polaris.simulation.run_metrics import evaluate
from polaris.simulation.simulate import simulate
from polaris.synthesis.schedule.synthesize import synthesize
from tests.leftovers import left_by_a_dead_process
from tests.polaris.runs.campaign import scene
from tests.polaris.runs.campaign.scene import GRID, MODES, RUNS, TINY, cases, fly, rows, run, table

ROOT = Path(__file__).parents[4]


def counting(monkeypatch):
    """Names of the parts flown from here on."""
    seen = []
    real = batch.fly_batch

    def fly_batch(task):
        seen.append((task.case, task.batch))
        return real(task)

    monkeypatch.setattr("polaris.runs.campaign.drive.fly_batch", fly_batch)
    return seen


# -- the table ----------------------------------------------------------------------------------------


def test_table_has_one_row_per_run_with_everything_that_was_measured(flown):
    lines = rows(flown.path)
    assert len(lines) == 2 * 2 * RUNS
    keys = {(row["case"], row["batch"], row["run"], row["mode"]) for row in lines}
    assert len(keys) == len(lines)
    seeds = {(row["case"], row["batch"]): (row["seed"], row["seed_truth"]) for row in lines}
    assert len(set(seeds.values())) == len(seeds), "every batch draws its own"
    for margin, mode in ((0.3, "polaris"), (0.4, "experimental")):
        mine = [row for row in lines if row["planner.extra_margin_m"] == margin and row["mode"] == mode]
        assert len(mine) == RUNS and {row["scenario"] for row in mine} == {"tiny"}
    # a batch is what `simulate` and `evaluate` give for the seeds in its rows
    first = [row for row in lines if (row["case"], row["batch"], row["mode"]) == (1, 2, "polaris")]
    schedule = synthesize(load_scenario(TINY).set("planner.extra_margin_m", 0.4))
    columns = evaluate(simulate(schedule, 5, first[0]["seed"]), first[0]["seed_truth"]).columns()
    assert set(columns) <= set(first[0])
    for name, values in columns.items():
        np.testing.assert_array_equal([row[name] for row in first], values)


def test_parameters_keep_their_types_in_the_table(tmp_path):
    grid = {"schedule.min_dwell_steps": [1, 2], "schedule.strategy": ["greedy"], "system.input_max": [1, 2.5]}
    folder = run(make_cases([TINY], grid)[:2], 2, tmp_path / "c")
    schema = pq.read_schema(next((folder.path / "runs").iterdir()))
    assert [str(schema.field(key).type) for key in grid] == ["int64", "string", "double"]
    assert {row["schedule.strategy"] for row in rows(folder.path)} == {"greedy"}


def test_summary_is_that_of_the_table(flown):
    lines = rows(flown.path)
    summary = flown.summary
    assert summary["flown"] == len(lines) and summary["runs"] == RUNS
    for case in summary["cases"]:
        for mode in MODES:
            mine = [row for row in lines if row["case"] == case["case"] and row["mode"] == mode]
            entry = case["modes"][mode]
            hits = sum(row["collided"] for row in mine)
            assert entry["violations"] == hits == (RUNS if mode == "experimental" else 0)
            chance = entry["violation_probability"]
            assert (chance["low"], chance["high"]) == violation_interval(hits, RUNS)
            spent = np.array([row["delta_v_m_s"] for row in mine])
            assert entry["mean"]["delta_v_m_s"]["mean"] == pytest.approx(spent.mean(), rel=1e-12)
            assert entry["worst"]["delta_v_m_s"] == spent.max()
            for name in ("max_thrust_ratio", "max_thrust_ratio_safety", "switches"):
                largest = max(row[name] for row in mine)  # of S's thrust where S never flies: no number
                assert entry["worst"][name] == (None if np.isnan(largest) else largest), name
            for name in ("min_distance_m", "experimental_share"):
                assert entry["worst"][name] == min(row[name] for row in mine), name
            nearest = sorted((row["min_distance_m"], row["batch"], row["run"]) for row in mine)[:5]
            worst = [(row["min_distance_m"], row["batch"], row["run"]) for row in entry["worst_runs"]]
            assert worst == nearest


# -- the same whoever flies ---------------------------------------------------------------------------


def test_executor_and_order_do_not_change_a_bit(flown, tmp_path):
    backwards = Lazy()
    assert table(fly(tmp_path / "backwards", Workers(lambda: backwards, lambda: 5)).path) == table(flown.path)
    assert backwards.order[:5] == [(0, batch) for batch in (4, 3, 2, 1, 0)]
    with ThreadPoolExecutor(3) as threads:
        assert table(fly(tmp_path / "threads", threads).path) == table(flown.path)
        assert threads.submit(int).result() == 0, "somebody else's executor is not closed"


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


def test_few_tasks_are_handed_out_at_a_time(tmp_path):
    lazy = Lazy()
    run(make_cases([TINY]), 30, tmp_path / "c", executor=Workers(lambda: lazy, lambda: 5), batch=3)
    assert lazy.most == 5 and len(lazy.order) == 10


# -- taken up again -----------------------------------------------------------------------------------


def test_finished_parts_are_not_flown_again(flown, copied, monkeypatch):
    out = copied
    (out / "runs" / "case-0001-batch-00002.parquet").unlink()
    left = left_by_a_dead_process(out / "runs")
    seen = counting(monkeypatch)
    fly(out)
    assert seen == [(1, 2)] and table(out) == table(flown.path) and not left.exists()
    del seen[:]
    fly(out)
    assert seen == []


def corrupt(path, kind):
    content = bytearray(path.read_bytes())
    if kind == "empty":
        content = b""
    elif kind == "cut":
        content = content[: len(content) // 2]
    elif kind == "bit":
        group = pq.ParquetFile(path).metadata.row_group(0)
        column = next(
            group.column(i)
            for i in range(group.num_columns)
            if group.column(i).path_in_schema == "min_distance_m"
        )
        first = column.dictionary_page_offset or column.data_page_offset
        content[first + column.total_compressed_size - 1] ^= 4  # of a number, not of a page's header
    elif kind == "footer":
        content[-20] ^= 255
    path.write_bytes(bytes(content))


@pytest.mark.parametrize("kind", ["empty", "cut", "bit", "footer"])
def test_damaged_parts_are_flown_again(flown, copied, monkeypatch, kind):
    out = copied
    corrupt(out / "runs" / "case-0000-batch-00003.parquet", kind)
    damaged = (out / "runs" / "case-0000-batch-00003.parquet").read_bytes()
    seen = counting(monkeypatch)
    fly(out)
    assert seen == [(0, 3)] and table(out) == table(flown.path)
    assert (out / "case-0000-batch-00003.parquet.kept").read_bytes() == damaged, "whoever changed it"


def test_a_part_of_elsewhere_is_flown_again(flown, copied, tmp_path, monkeypatch):
    out, other = copied, fly(tmp_path / "d", seed=8).path
    parts = [folder / "runs" / "case-0000-batch-00001.parquet" for folder in (out, other)]
    parts[0].write_bytes(parts[1].read_bytes())
    (out / "runs" / "case-0001-batch-00000.parquet").write_bytes(
        (out / "runs" / "case-0001-batch-00001.parquet").read_bytes()
    )
    seen = counting(monkeypatch)
    fly(out)
    assert seen == [(0, 1), (1, 0)] and table(out) == table(flown.path)


def test_each_experimental_controller_flies_by_the_key_it_has_in_a_run_folder(tmp_path):
    scenario = load_scenario(TINY)
    first = scenario.to_dict()["experimental"][0]
    both = scenario.set("experimental", [first | {"name": "other", "Q": [1.0, 1.0, 1.0, 1.0]}, first])
    out = run(make_cases([both]), 3, tmp_path / "c", modes=("experimental", "experimental_2"), calm=True).path
    flown = {
        mode: [row for row in rows(out) if row["mode"] == mode] for mode in ("experimental", "experimental_2")
    }
    assert {mode: {row["controller"] for row in some} for mode, some in flown.items()} == {
        "experimental": {"other"},
        "experimental_2": {"hasty"},
    }
    alone = run(make_cases([both]), 3, tmp_path / "d", modes=("experimental_2",), calm=True).path
    assert [row["min_distance_m"] for row in rows(alone)] == [
        row["min_distance_m"] for row in flown["experimental_2"]
    ]


def test_more_runs_extend_a_campaign_and_fewer_are_refused(flown, tmp_path, monkeypatch):
    options = {"batch": 5, "modes": MODES, "seed": 7}
    out = run(cases(), 13, tmp_path / "c", **options).path
    seen = counting(monkeypatch)
    assert run(cases(), RUNS, out, **options).summary["runs"] == RUNS
    assert seen == [(case, number) for case in (0, 1) for number in (2, 3, 4)]
    assert table(out) == table(flown.path)
    with pytest.raises(ScenarioError, match=f"must be at least {RUNS}"):
        run(cases(), 13, out, **options)


def test_another_campaign_is_refused_unless_asked_to_be_replaced(tmp_path):
    out = tmp_path / "c"
    run(make_cases([TINY]), 3, out)
    with pytest.raises(ScenarioError, match=r"another campaign \(other seed\); --fresh"):
        run(make_cases([TINY]), 3, out, seed=1)
    with pytest.raises(ScenarioError, match=r"other cases"):
        run(make_cases([TINY], GRID), 3, out)
    assert run(make_cases([TINY]), 3, out, seed=1, fresh=True).plan.seed == 1
    assert {path.name for path in tmp_path.iterdir()} == {"c"}


def test_other_folders_are_not_touched(tmp_path):
    with replacing(tmp_path / "full") as beside:
        (beside / "summary.json").write_text("{}", encoding="utf-8")
    for fresh in (False, True):
        with pytest.raises(ScenarioError, match="run folder"):
            run(make_cases([TINY]), 3, tmp_path / "full", fresh=fresh)
    (tmp_path / "full" / "summary.json").rename(tmp_path / "full" / "precious")
    (tmp_path / "full" / MANIFEST).unlink()
    with pytest.raises(ScenarioError, match="other contents"):
        run(make_cases([TINY]), 3, tmp_path / "full", fresh=True)
    assert [path.name for path in (tmp_path / "full").iterdir()] == ["precious"]


def test_damaged_manifests_are_told(tmp_path):
    out = run(make_cases([TINY]), 3, tmp_path / "c").path
    manifest = out / "manifest.json"
    data = json.loads(manifest.read_text(encoding="utf-8"))
    for changed, word in (
        ({**data, "seed": 5}, "digest does not fit"),
        ({**data, "version": "0.0.1"}, "version 0.0.1"),
        ({**data, "cases": 3}, "damaged"),
        ([], "damaged"),
    ):
        manifest.write_text(json.dumps(changed), encoding="utf-8")
        with pytest.raises(ScenarioError, match=word):
            read_campaign(out)
    with pytest.raises(ScenarioError, match=r"no manifest\.json"):
        read_campaign(tmp_path)


KILLED = """
import sys
from polaris.runs.campaign import local
from tests.polaris.runs.campaign.scene import fly
if __name__ == "__main__":
    fly(sys.argv[1], local(int(sys.argv[2])))
"""


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_killed_campaign_leaves_whole_parts_and_goes_on(flown, tmp_path, workers):
    out, script = tmp_path / "c", tmp_path / "killed.py"
    script.write_text(KILLED, encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, str(script), str(out), str(workers)]
    child = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE)
    try:
        scene.await_parts(out, 2, child)
    finally:
        child.send_signal(signal.SIGKILL)
        child.wait()
    left = {path.name: path.read_bytes() for path in (out / "runs").glob("case-*.parquet")}
    whole = table(flown.path)
    assert len(left) > 0 and left.items() <= whole.items(), "parts are whole or absent"
    assert child.stdout is not None and child.stdout.read() == b"", "open while any of its processes lives"
    assert table(fly(out).path) == whole


# -- workers that are lost, users that interrupt ------------------------------------------------------


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


def test_a_broken_pool_is_replaced(flown, tmp_path):
    made = []

    def pool():
        made.append(Breaking())
        return made[-1]

    assert table(fly(tmp_path / "c", Workers(pool, lambda: 3)).path) == table(flown.path)
    assert len(made) == 5


def test_a_pool_that_only_breaks_is_given_up_and_parts_are_kept(flown, tmp_path):
    pools = iter([2, 0, 0, 0, 0, 0])
    with pytest.raises(PolarisError, match="lost 4 times.*10 runs are kept in .*goes on from there"):
        fly(tmp_path / "c", Workers(lambda: Breaking(next(pools)), lambda: 3))
    assert len(table(tmp_path / "c")) == 2
    assert next(pools) == 0
    with pytest.raises(PolarisError, match="lost"):
        fly(tmp_path / "c", Breaking(1))
    assert len(table(tmp_path / "c")) == 3
    assert table(fly(tmp_path / "c").path) == table(flown.path)


@pytest.fixture
def victim(tmp_path, monkeypatch):
    """Names the batch in which a process kills itself."""
    flag = tmp_path / "flag"
    monkeypatch.setenv("POLARIS_TEST_FLAG", str(flag))
    monkeypatch.setattr("polaris.runs.campaign.drive.fly_batch", scene.suicidal)
    yield lambda name: flag.write_text(name, encoding="utf-8")
    assert not flag.exists()


@pytest.mark.slow
def test_a_process_of_the_pool_that_is_killed_loses_nothing(flown, tmp_path, victim):
    victim("0 3")
    assert table(fly(tmp_path / "c", local(2)).path) == table(flown.path)


@pytest.mark.slow  # `Breaking` stands for it in the others
def test_the_only_process_of_a_pool_is_killed_and_another_takes_its_place(tmp_path, victim):
    one = cases()[:1]  # a single task: the pool starts a single process
    whole = run(one, 4, tmp_path / "here")
    victim("0 0")
    assert table(run(one, 4, tmp_path / "c", executor=local(2)).path) == table(whole.path)


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


# -- cases that cannot be flown -----------------------------------------------------------------------


def test_a_case_without_a_schedule_is_told_and_stops_nothing(tmp_path, monkeypatch):
    weak = make_cases([TINY], {"system.input_max": [0.02, 1.0]})
    folder = run(weak, 9, tmp_path / "c", batch=3)
    bad, good = folder.summary["cases"]
    assert bad["exit_code"] == 3 and "To make it feasible" in bad["failure"] and "modes" not in bad
    assert good["modes"]["polaris"]["runs"] == 9
    assert {row["case"] for row in rows(folder.path)} == {1}
    seen = counting(monkeypatch)
    run(weak, 9, folder.path, batch=3)
    assert seen == [], "infeasible is infeasible"


def test_a_case_that_was_not_decided_in_time_is_tried_again(tmp_path, monkeypatch):
    late = make_cases([TINY], {"planner.time_limit_s": [1e-9]})
    folder = run(late, 3, tmp_path / "c")
    assert folder.summary["cases"][0]["exit_code"] == 4 and folder.summary["flown"] == 0
    seen = counting(monkeypatch)
    run(late, 3, folder.path)
    assert seen == [(0, 0)]


def test_a_schedule_that_hangs_on_the_clock_is_not_flown(tmp_path, monkeypatch):
    """Another machine might fly another one."""
    from polaris.planning.effort import SearchEffort

    with monkeypatch.context() as late:
        late.setattr(schedules, "_made", schedules._made.__wrapped__)  # others keep what they made
        struck = property(lambda self: ("fuel",) if self.search.rows.problem.unsafe else ())
        late.setattr(SearchEffort, "cut_by_clock", struck)
        summary = run(make_cases([TINY]), 3, tmp_path / "c").summary
    assert summary["flown"] == 0 and "raise planner.time_limit_s" in summary["cases"][0]["failure"]
    assert summary["cases"][0]["exit_code"] == 4
    assert run(make_cases([TINY]), 3, tmp_path / "c").summary["flown"] == 3


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


def test_replacing_a_campaign_leaves_what_it_did_not_write(tmp_path):
    out = run(make_cases([TINY]), 3, tmp_path / "c").path
    (out / "notes.txt").write_text("mine", encoding="utf-8")
    (out / "runs" / "plot.py").write_text("mine too", encoding="utf-8")
    (out / "runs" / "case-0007-batch-00000.parquet").write_bytes(b"somebody's copy")
    run(make_cases([TINY]), 2, out, seed=1, fresh=True)
    left = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
    parts = {f"runs/case-000{case}-batch-00000.parquet" for case in (0, 7)}
    assert left == {"manifest.json", "summary.json", MANIFEST, "notes.txt", "runs/plot.py"} | parts


def test_schedules_that_differ_between_workers_are_an_error(tmp_path, monkeypatch):
    real = batch.fly_batch

    def fly_batch(task):
        made = real(task)
        return batch.Batch("0" * 64, made.columns) if task.batch == 1 else made

    monkeypatch.setattr("polaris.runs.campaign.drive.fly_batch", fly_batch)
    with pytest.raises(PolarisError, match="different schedules.*5 runs are kept"):
        fly(tmp_path / "c")


def test_a_schedule_that_differs_from_that_of_parts_kept_is_an_error(tmp_path, monkeypatch):
    out, real = run(make_cases([TINY]), 9, tmp_path / "c", batch=3).path, batch.fly_batch
    (out / "runs" / "case-0000-batch-00001.parquet").unlink()
    changed = "polaris.runs.campaign.drive.fly_batch"
    monkeypatch.setattr(changed, lambda task: batch.Batch("0" * 64, real(task).columns))
    with pytest.raises(PolarisError, match="different schedules"):
        run(make_cases([TINY]), 9, out, batch=3)


def test_a_worker_of_another_version_refuses(flown, monkeypatch):
    task = flown.plan.task(0, 0)
    monkeypatch.setattr("polaris.runs.campaign.batch.version", lambda: "99.0")
    with pytest.raises(PolarisError, match=r"has Polaris 99\.0"):
        batch.fly_batch(task)
