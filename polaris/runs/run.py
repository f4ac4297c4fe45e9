"""Run a scenario of any kind into a folder, and open a folder of any kind."""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

from ..model.errors import ScenarioError
from ..model.files import parse_toml, read_text
from ..scenario.scenario import MonteCarloScenario, Scenario, ScheduleScenario, load_scenario, loaded
from ..synthesis.controllers.black_box import Ask
from .campaign.workers import Workers
from .comparison import COMPARISON
from .files.atomic import check_target
from .files.folder import SCENARIO, Draw, RunFolder, RunKind, read_json, write_folder
from .files.ownership import sha256
from .inspections.fuel_limit import FUEL_LIMIT
from .inspections.inspection import FLIGHT
from .inspections.monte_carlo import MONTE_CARLO, run_monte_carlo
from .missions.mission import MISSION
from .schedule import SCHEDULE
from .stages import Stages
from .tradeoff_points import TRADEOFF

KINDS: dict[str, RunKind] = {kind.name: kind for kind in (SCHEDULE, FLIGHT, FUEL_LIMIT, MONTE_CARLO, MISSION)}
"""Kinds of run folders, by the kind of the scenario."""


def run(
    scenario: str | Path | Scenario,
    out: str | Path | None = None,
    *,
    overrides: Sequence[str] = (),
    draw: Draw | None = None,
    stages: Stages | None = None,
    executor: Executor | Workers | None = None,
    fresh: bool = False,
    black_boxes: Mapping[str, Ask] | None = None,
) -> RunFolder:
    """Run a scenario and write the results into a folder, as ``polaris run`` does.

    A schedule is synthesised, proven and flown in simulation; a flight of the inspection problem is flown
    under its filter and judged, one into the fuel limit until the backup has taken over, many as a campaign.

    Parameters
    ----------
    scenario : str, Path or Scenario
        A bundled name, a file, or what `load_scenario` returned.
    out : path, optional
        Default ``runs/<name of the scenario>``; an older run is replaced, many flights are continued.
    overrides : sequence of str
        Texts ``key=value`` as for ``--set``, which the folder notes.
    draw : callable, optional
        Puts the figures into the folder: `polaris.draw_run`, which can also do so later.
    stages : Stages, optional
        Told what is being done, and how far it is.
    executor, fresh
        Of many flights: who flies, and whether others are replaced, as in `run_campaign`.
    black_boxes : mapping, optional
        What is asked of black boxes, by name: from a time [s], states (R, n) and the state (n,) of the safe
        reference it returns commands (R, m). A scenario file starts no program.

    Raises
    ------
    ScenarioError
        If the scenario is not valid, or `out` is something else than a run folder or cannot be written.
    SynthesisInfeasible, NotCertified
        If there is no schedule, or none is found in the time given.

    Examples
    --------
    >>> import polaris, tempfile
    >>> with tempfile.TemporaryDirectory() as place:
    ...     folder = polaris.run("inspection", f"{place}/short", overrides=["flight.duration_s=5"])
    ...     print(folder.summary["safe"], folder.picture().x.shape)
    True (6, 5, 6)
    """
    stages, scenario = stages or Stages(), loaded(scenario, overrides, Scenario)
    target = f"runs/{scenario.name}" if out is None else out
    if isinstance(scenario, MonteCarloScenario):
        with stages.stage("runs"):
            progress = stages.counting("{:,} of {:,} runs")
            campaign = run_monte_carlo(target, scenario, progress=progress, executor=executor, fresh=fresh)
        folder = RunFolder(campaign.path, scenario, MONTE_CARLO)
        if draw is not None:
            with stages.stage("figures"):
                draw(folder)
        return folder
    kind = KINDS[scenario.kind]
    place = check_target(target, kind.names)
    assert kind.fly is not None
    if black_boxes and not isinstance(scenario, ScheduleScenario):
        raise ScenarioError("black box", list(black_boxes), "must belong to a scenario of a schedule")
    outcome = kind.fly(scenario, stages, **({"boxes": black_boxes} if black_boxes else {}))
    with stages.stage("run folder"):
        return write_folder(place, kind, scenario, outcome, draw=draw, stages=stages)


def read_run(path: str | Path) -> RunFolder:
    """Open a folder: a schedule, a flight, one into the fuel limit, many flights, comparison, trade-off.

    Raises
    ------
    ScenarioError
        If it is none, its scenario cannot be read, or a file is no longer what was written with the
        others: what a changed scenario shows was never proven.
    """
    folder = Path(path)
    kind = _kind_of(folder)
    for name in kind.files:
        if not (folder / name).is_file():
            other = "is a file; must be a run folder" if folder.exists() else "there is no such folder"
            rule = f"must be a run folder; it has no {name}" if folder.is_dir() else other
            raise ScenarioError("run folder", str(path), rule)
    if kind is COMPARISON:
        return RunFolder(folder, read_run(folder / "run").scenario, kind)
    for name, digest in _hashes(folder / "certificate.json").items():
        known_file = name in kind.files or ((folder / name).is_file() and name.endswith(".onnx"))
        if known_file and sha256(folder / name) != digest:
            rule = "was edited or damaged after the run was written; run the scenario again"
            raise ScenarioError("run folder", str(folder / name), rule)
    return RunFolder(folder, load_scenario(folder / SCENARIO), kind)


def _kind_of(folder: Path) -> RunKind:
    """Return the kind of a folder, as far as the files that tell it can be read."""
    for kind in (COMPARISON, TRADEOFF):
        if (folder / kind.summary).is_file():
            return kind
    try:
        name = parse_toml(read_text(folder / SCENARIO)).get("kind")
    except (OSError, ValueError):
        return SCHEDULE
    return KINDS.get(name, SCHEDULE) if isinstance(name, str) else SCHEDULE


def _hashes(path: Path) -> dict[str, Any]:
    """Return hashes by file name as a certificate has them; none without a certificate."""
    return dict(read_json(path)["artefacts"]) if path.exists() else {}
