"""Trade-offs: a scenario at several prices of velocity change, or values of any fields, a run folder each."""

import re
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path

from ..model.checks import non_negative, number
from ..model.errors import (
    ClockWarning,
    NotCertified,
    PolarisError,
    ScenarioError,
    SynthesisInfeasible,
    failed,
)
from ..model.version import versions
from ..scenario.base import parse_assignment
from ..scenario.scenario import ScheduleScenario, loaded
from ..synthesis.controllers.black_box import Ask
from .campaign.workers import AHEAD, Workers, going_on, work_through, workers_of
from .files.atomic import check_target
from .files.folder import SCENARIO, Draw, RunFolder, read_json, write_folder
from .files.ownership import MANIFEST, read_list, start_list, tidy
from .run import read_run, run
from .schedule import SCHEDULE
from .stages import Stages
from .tradeoff_points import INFEASIBLE, TRADEOFF, Row, infeasible_row, non_dominated, row_of

PRICES = (0.0, 0.02, 0.06, 0.1, 0.2, 0.5)  # prices of velocity change, if none are given

# Folder of a point, its scenario, whether that it has no schedule is a result, and what boxes are asked.
Point = tuple[Path, ScheduleScenario, bool, Mapping[str, Ask] | None]
Values = Mapping[str, tuple[str, float | None]]  # field and value of every point, by the name of its folder

PRICE, RECOURSE = "schedule.delta_v_price", "recoverable.recourse"


def tradeoff(
    scenario: str | Path | ScheduleScenario,
    out: str | Path | None = None,
    prices: Iterable[float] | Mapping[str, Iterable[float]] = PRICES,
    *,
    share: float = 0.9,
    overrides: Sequence[str] = (),
    draw: Draw | None = None,
    stages: Stages | None = None,
    executor: Executor | Workers | None = None,
    black_boxes: Mapping[str, Ask] | None = None,
) -> RunFolder:
    """Compare a scenario's schedules at several values of a key: the cost of time under U, or its cause.

    Each point is a run folder; points already there, whole and from the same scenario and versions, are kept.

    Parameters
    ----------
    scenario : str, Path or ScheduleScenario
        A bundled name, a file, or what `load_scenario` returned.
    out : path, optional
        Folder of the trade-off; default ``runs/<name of the scenario>-tradeoff``.
    prices : iterable of float, or mapping of str to iterable of float
        Values of ``schedule.delta_v_price`` [-], at least 0, each once; or values of any numbers of the
        scenario by their keys, as in ``navigation.position_error_m``: each is changed alone.
    share : float
        Share of the time under U for which the summary says how far such a field may go.
    overrides, draw, stages, executor, black_boxes
        As for `polaris.run`; overrides hold at all points, which `executor` computes; with black boxes this
        process computes all of them anew.

    Returns
    -------
    RunFolder
        ``tradeoff.json`` has a row for each point, infeasible ones too, the printed algorithms' last.

    Raises
    ------
    PolarisError
        `ScenarioError` for what is not valid, or `out`; that of a point if a price has no schedule.
    """
    stages = stages or Stages()
    if black_boxes and executor is not None:
        raise ScenarioError("executor", type(executor).__name__, "must be left out with black boxes")
    scenario = loaded(scenario, overrides, ScheduleScenario)
    if not 0 < number("share", share) <= 1:
        raise ScenarioError("share", share, "must be above 0 and at most 1")
    values = _labelled(prices)
    points, swept = _points(scenario, values, overrides), "printed" not in values
    for point in points.values():
        point.check_black_boxes(black_boxes)
    target = _open_folder(f"runs/{scenario.name}-tradeoff" if out is None else out)
    with stages.stage("points"):
        tasks = [(target / name, one, swept, black_boxes) for name, one in points.items()]
        _compute(tasks, target, workers_of(executor), stages.counting("{} of {} points"))
        rows = [_row(target, name, *values[name]) for name in points]
    with stages.stage("folder"):
        chosen: list[bool | None] = [None] * len(rows) if swept else [*non_dominated(rows)]
        table: list[Row] = [row | {"non_dominated": one} for row, one in zip(rows, chosen, strict=True)]
        return write_folder(target, TRADEOFF, scenario, (table, share), draw=draw, stages=stages)


def _points(
    scenario: ScheduleScenario, values: Values, overrides: Sequence[str]
) -> dict[str, ScheduleScenario]:
    """Return the scenario of every point, by the name of its folder."""
    fields = {field for field, _ in values.values()}
    for field in fields & {parse_assignment(text)[0] for text in overrides}:
        raise ScenarioError("--set", field, "must be left out, as the trade-off varies it")
    if PRICE in fields and scenario.model.recoverable.recourse == "none":
        raise ScenarioError(RECOURSE, "none", "must be left out, as prices need recourse")
    texts = {
        name: f"{RECOURSE}=none" if value is None else f"{key}={repr(value).removesuffix('.0')}"
        for name, (key, value) in values.items()
    }
    return {name: scenario.with_assignments([text]) for name, text in texts.items()}


def _labelled(values: Iterable[float] | Mapping[str, Iterable[float]]) -> Values:
    """Fields and values in order, by the names of their folders; beside prices alone none, as printed."""
    points: dict[str, tuple[str, float | None]] = {}
    for field, field_values in (values if isinstance(values, Mapping) else {PRICE: values}).items():
        label = "prices" if field == PRICE else field
        numbers = [number(label, value) + 0.0 for value in field_values]  # -0 is 0
        if field == PRICE:
            numbers = [non_negative(label, value, "-") for value in numbers]
        if not numbers or len(set(numbers)) < len(numbers):
            raise ScenarioError(label, numbers, "must be at least one, each once")
        folder = "price" if field == PRICE else re.sub(r"\W+", ".", field).strip(".")
        points |= {f"{folder}-{repr(value).removesuffix('.0')}": (field, value) for value in sorted(numbers)}
    if not points:
        raise ScenarioError("fields", [], "must be at least one")
    return points if isinstance(values, Mapping) else {**points, "printed": (PRICE, None)}


def _row(target: Path, name: str, field: str, value: float | None) -> Row:
    if (target / name / INFEASIBLE.summary).is_file():
        return infeasible_row(target / name, field, value)
    return row_of(read_run(target / name), name, field, value)


def _open_folder(out: str | Path) -> Path:
    """Make the folder, or take up one of an earlier trade-off; `ScenarioError` if there is something else."""
    target = check_target(out, TRADEOFF.names)
    files = read_list(target) if target.exists() else None
    if files and TRADEOFF.summary not in files:
        raise ScenarioError("--out", str(out), "must be empty or hold this trade-off; give another folder")
    target.mkdir(parents=True, exist_ok=True)
    if files is None:
        start_list(target)  # of nothing yet: it says whose folder this is
    tidy(target)
    return target


def _is_complete(folder: Path, scenario: ScheduleScenario) -> bool:
    """Return True if a point is there, undamaged, of this scenario and these versions."""
    try:
        same = (folder / SCENARIO).read_bytes() == scenario.copy_text().encode()
        if (folder / INFEASIBLE.summary).is_file():
            return same and read_json(folder / INFEASIBLE.summary)["versions"] == versions()
        point = read_run(folder)
        row_of(point, folder.name, PRICE, None)
        complete = set(point.json("certificate.json")["artefacts"]) >= set(SCHEDULE.files)
        return same and complete and point.kind is SCHEDULE and point.summary["versions"] == versions()
    except (PolarisError, OSError, KeyError, TypeError):
        return False


def _compute(
    points: Sequence[Point], target: Path, workers: Workers, progress: Callable[[int, int], None]
) -> None:
    """Write the run folders of the points that are not there yet, or whose black boxes are asked anew."""
    missing = [point for point in points if point[3] or not _is_complete(*point[:2])]
    count, done = len(points), len(points) - len(missing)
    progress(done, count)

    def keep(point: Point, failure: tuple[str, int] | None) -> None:
        nonlocal done
        if failure:
            if [path.name for path in target.iterdir()] == [MANIFEST]:  # nothing to go on from
                (target / MANIFEST).unlink()
                target.rmdir()
            raise failed(f"{point[0].name}: {failure[0]}", failure[1])
        done += 1
        progress(done, count)

    one_each = replace(workers, window=lambda: max(workers.window() // AHEAD, 1))  # none waits to be cut off
    with going_on(lambda: f"points that are done are kept in {target}"):
        if missing and work_through(one_each, _write_point, iter(missing), keep):
            raise PolarisError("a worker was lost (out of memory, or killed?)")


def _write_point(point: Point) -> tuple[str, int] | None:
    """Write the run folder of a point, in whatever process; else why there is none, and its exit code."""
    folder, scenario, swept, boxes = point
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ClockWarning)  # the table tells
            run(scenario, folder, black_boxes=boxes)
    except (SynthesisInfeasible, NotCertified) as error:
        if not swept:
            return str(error), error.exit_code
        write_folder(check_target(folder, INFEASIBLE.names), INFEASIBLE, scenario, str(error))
    except PolarisError as error:
        return str(error), error.exit_code
    return None
