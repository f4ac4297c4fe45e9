"""Trade-offs: one scenario at several prices of velocity change, a run folder each."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path

from ..model.checks import non_negative
from ..model.errors import ClockWarning, PolarisError, ScenarioError, failed
from ..model.version import versions
from ..scenario.base import parse_assignment
from ..scenario.scenario import ScheduleScenario, load_scenario
from .atomic import check_target
from .campaign.workers import AHEAD, Workers, going_on, work_through, workers_of
from .comparison import TRADEOFF, Row, non_dominated, row_of
from .folder import SCENARIO, Draw, RunFolder, write_folder
from .ownership import listed, tidy_all, write_manifest
from .run import read_run, run
from .schedule import SCHEDULE
from .stages import Stages

PRICES = (0.0, 0.02, 0.06, 0.1, 0.2, 0.5)  # prices of velocity change, if none are given
Point = tuple[Path, ScheduleScenario]  # folder of a point and its scenario

PRICE, RECOURSE = "schedule.delta_v_price", "recoverable.recourse"


def tradeoff(
    scenario: str | Path | ScheduleScenario,
    out: str | Path | None = None,
    prices: Iterable[float] = PRICES,
    *,
    overrides: Sequence[str] = (),
    draw: Draw | None = None,
    stages: Stages | None = None,
    executor: Executor | Workers | None = None,
) -> RunFolder:
    """Find what the time of U costs: the schedules of one scenario at several prices of velocity change.

    Each point is a run folder of its own, as `polaris.run` writes it, and one more is that of the printed
    algorithms. Points that are there already, whole and from the same scenario and versions, are kept: what
    was stopped goes on where it was.

    Parameters
    ----------
    scenario : str, Path or ScheduleScenario
        A bundled name, a file, or what `load_scenario` returned.
    out : path, optional
        Folder of the trade-off; default ``runs/<name of the scenario>-tradeoff``.
    prices : iterable of float
        Values of ``schedule.delta_v_price`` [-], at least 0, each once.
    overrides : sequence of str
        Texts ``key=value`` that hold at all points.
    draw : callable, optional
        Puts the figure into the folder: `polaris.draw_run`, which can also do so later.
    stages : Stages, optional
        Told how many points there are.
    executor : concurrent.futures.Executor or Workers, optional
        Who computes points, as in `run_campaign`; by default this process.

    Returns
    -------
    RunFolder
        Its summary, ``tradeoff.json``, has a row for each point, by price, the printed algorithms' last.

    Raises
    ------
    ScenarioError
        If the scenario or a price is not valid, or `out` is something else or cannot be written.
    SynthesisInfeasible, NotCertified
        As a `PolarisError` with their exit code, if a point has no schedule.
    """
    stages = stages or Stages()
    if isinstance(scenario, ScheduleScenario):
        scenario = scenario.with_assignments(overrides)
    else:
        scenario = load_scenario(scenario, overrides, only=ScheduleScenario)
    if PRICE in (parse_assignment(text)[0] for text in overrides):
        raise ScenarioError("--set", PRICE, "must be left out: the prices are those of the trade-off")
    if scenario.model.recoverable.recourse == "none":
        raise ScenarioError(RECOURSE, "none", "must be left out: without recourse no price is paid")
    named = _named(prices)
    points = {name: scenario.with_assignments([f"{PRICE}={price!r}"]) for name, price in named.items()}
    points["printed"] = scenario.with_assignments([f"{RECOURSE}=none"])
    target = _take_up(f"runs/{scenario.name}-tradeoff" if out is None else out)
    with stages.stage("points"):
        _compute(points, target, workers_of(executor), stages.counting("{} of {} points"))
        rows = [row_of(read_run(target / name), name, named.get(name)) for name in points]
    with stages.stage("folder"):
        chosen = non_dominated(rows)
        told: list[Row] = [row | {"non_dominated": one} for row, one in zip(rows, chosen, strict=True)]
        return write_folder(target, TRADEOFF, scenario, told, draw=draw, stages=stages)


def _named(prices: Iterable[float]) -> dict[str, float]:
    """Prices in order, by the names of their folders."""
    found = [non_negative("prices", price, "-") + 0.0 for price in prices]  # -0 is 0
    if not found or len(set(found)) < len(found):
        raise ScenarioError("prices", found, "must be at least one, each once")
    return {f"price-{repr(price).removesuffix('.0')}": price for price in sorted(found)}


def _take_up(out: str | Path) -> Path:
    """Make the folder, or take up one of an earlier trade-off; `ScenarioError` if there is something else."""
    target = check_target(out)
    files = listed(target)
    if files and TRADEOFF.summary not in files:
        raise ScenarioError("--out", str(out), "holds other results; a trade-off needs a folder of its own")
    target.mkdir(parents=True, exist_ok=True)
    if files is None:
        write_manifest(target)  # of nothing yet: it says whose folder this is
    tidy_all(target)
    return target


def _whole(folder: Path, scenario: ScheduleScenario) -> bool:
    """Whether a point is there, undamaged, of this scenario and these versions."""
    try:
        found = read_run(folder)
        row_of(found, folder.name, None)
        same = (folder / SCENARIO).read_bytes() == scenario.copy_text().encode()
        known = set(found.json("certificate.json")["artefacts"]) >= set(SCHEDULE.files)
        return same and known and found.kind is SCHEDULE and found.summary["versions"] == versions()
    except (PolarisError, OSError, KeyError, TypeError):
        return False


def _compute(
    points: Mapping[str, ScheduleScenario],
    target: Path,
    workers: Workers,
    progress: Callable[[int, int], None],
) -> None:
    """Write the run folders of all points that are not there yet."""
    missing = [(target / name, one) for name, one in points.items() if not _whole(target / name, one)]
    done = len(points) - len(missing)
    progress(done, len(points))

    def keep(point: Point, failure: tuple[str, int] | None) -> None:
        nonlocal done
        if failure:
            raise failed(f"{point[0].name}: {failure[0]}", failure[1])
        done += 1
        progress(done, len(points))

    one_each = replace(workers, window=lambda: max(workers.window() // AHEAD, 1))  # none waits to be cut off
    with going_on(lambda: f"points that are done are kept in {target}"):
        if missing and work_through(one_each, _write_point, iter(missing), keep):
            raise PolarisError("a worker was lost (out of memory, or killed?)")


def _write_point(point: Point) -> tuple[str, int] | None:
    """Write the run folder of a point, in whatever process; else why there is none, and the exit code."""
    folder, scenario = point
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ClockWarning)  # the table tells
            run(scenario, folder)
    except PolarisError as error:
        return str(error), error.exit_code
    return None
