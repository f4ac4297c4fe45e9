"""The scene of these tests, campaigns flown on it, and their tables to the bit."""

import time
from pathlib import Path

import pyarrow.parquet as pq

from polaris.runs.campaign import CampaignPlan, ScheduleRuns, local, make_cases, run_campaign

TINY = str(Path(__file__).parents[3] / "polaris" / "data" / "tiny.toml")
GRID = {"planner.extra_margin_m": [0.3, 0.4]}
MODES = ("polaris", "experimental")
RUNS, BATCH = 22, 5


def cases():
    return make_cases([TINY], GRID)


def run(chosen, runs, out, *, executor=None, fresh=False, modes=("polaris",), calm=False, **plan):
    """A campaign of schedules, of flights without faults if it is `calm`."""
    kind = ScheduleRuns(modes, disturbance="mixed") if calm else ScheduleRuns(modes)
    planned = CampaignPlan(chosen, runs, kind=kind, **plan)
    return run_campaign(planned, out, executor=executor, fresh=fresh)


def fly(out, executor=None, **changed):
    """A campaign of two cases, five batches each, the last one short."""
    options = {"batch": BATCH, "modes": MODES, "seed": 7} | changed
    return run(cases(), RUNS, out, executor=executor or local(1), **options)


def table(out):
    """Every file of the table, byte for byte: NaN included, and types, and what it belongs to."""
    return {path.name: path.read_bytes() for path in sorted((Path(out) / "runs").iterdir())}


def rows(out):
    """All rows of the table as plain data."""
    return [row for path in sorted((Path(out) / "runs").glob("case-*.parquet")) for row in read(path)]


def read(path):
    return pq.read_table(path).to_pylist()


def await_parts(out, count, process=None):
    """Wait until a campaign has written some parts."""
    until = time.monotonic() + 300
    while len(list((out / "runs").glob("case-*.parquet"))) < count:
        assert time.monotonic() < until and (process is None or process.poll() is None)
        time.sleep(0.005)
