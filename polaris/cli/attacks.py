"""The verbs that try to prove a run wrong: model-error, falsify, replay, verify."""

from __future__ import annotations

import math
import shlex
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from typer import Argument, Option

from .shell import REFUTED, Assignments, Force, Json, Target, echo, print_result, verb

if TYPE_CHECKING:
    from ..runs.files.folder import RunFolder
    from ..simulation.falsification.search import Falsification
    from ..simulation.orbit.model_error import ModelError


@verb("model-error")
def model_error_command(
    target: Target,
    fit: bool = Option(False, "--fit", help="Find a disturbance bound that covers its model error."),
    within: float | None = Option(None, metavar="M", min=0.1, help="Distance from the target; no synthesis."),
    assignments: Assignments = None,
    as_json: Json = False,
) -> int | None:
    """Bound the acceleration that the linear model neglects, and compare it with the disturbance bound.

    The scenario must have a table [orbit]; with a run folder --set may change only that table.
    """
    from ..runs.case import load_target
    from ..simulation.orbit.environment import Environment
    from ..simulation.orbit.model_error import error_within, justify, model_error

    loaded = load_target(target, assignments or (), table="orbit")
    Environment.from_scenario(loaded.scenario)  # what is missing is refused before the synthesis
    for note in () if as_json else loaded.scenario.derived:
        echo(f"note: {note}", err=True)
    if within is not None:
        bound, scenario = error_within(loaded.scenario, within), loaded.scenario
        total, declared = float(bound.total), scenario.system().w_max
        parts = {name: float(value) for name, value in bound.parts.items()}
        data = {"scenario": scenario.name, "within_m": within, "declared_m_s2": declared, "bound_m_s2": total}
        show = partial(_show_within, data | {"parts_m_s2": parts})
        print_result(data | {"parts_m_s2": parts, "covered": total <= declared}, as_json, show)
        return None if total <= declared else REFUTED
    error = justify(loaded.scenario) if fit else model_error(loaded.scenario, loaded.schedule())
    print_result(error.summary(), as_json, partial(_show_model_error, error))
    return None if error.covered else REFUTED


@verb("falsify")
def falsify_command(
    target: Target,
    runs: int = Option(10_000, min=1, help="Number of trajectories."),
    seed: int = Option(0, min=0, help="Seed of the search; equal seeds give equal results."),
    out: str | None = Option(None, metavar="FILE", help="File of the case; default <scenario>.case.json."),
    assignments: Assignments = None,
    code: str | None = Option(None, metavar="DIR", help="Flight code to fly, from polaris export c."),
    force: Force = False,
    as_json: Json = False,
) -> int | None:
    """Search for a run that violates the guarantee of a schedule, and save it as a case."""
    from ..runs.case import load_target, write_case
    from ..runs.files.atomic import check_file
    from ..simulation.falsification.search import falsify
    from ..simulation.on_board import FlightCode

    if out is not None:
        check_file(out, endings=(".json",), force=force)
    if not assignments and (mission := _mission(target)) is not None:
        return _falsify_mission(mission, runs, seed, as_json)
    loaded = load_target(target, assignments or ())
    scenario = loaded.scenario
    check_file(out or f"{scenario.name}.case.json", force=force)
    compiled = None if code is None else FlightCode(code)
    attack = falsify(loaded.schedule(), runs, seed, code=compiled)
    print_result(attack.summary(), as_json, partial(show_falsification, scenario.name, attack))
    if attack.failure is not None:
        path = write_case(out or f"{scenario.name}.case.json", scenario, attack, force=force)
        option = "" if code is None else f" --code {shlex.quote(code)}"
        echo(f"Saved: polaris replay {shlex.quote(str(path))}{option}", err=True)
    return REFUTED if attack.failure is not None else None


def _mission(target: str) -> RunFolder | None:
    """Return the run folder of a mission, if it is one."""
    from ..runs.missions.mission import MISSION
    from ..runs.run import read_run
    from ..scenario.scenario import bundled_files

    is_scenario = target in bundled_files() or not Path(target).is_dir()
    folder = None if is_scenario else read_run(target)
    return folder if folder is not None and folder.kind is MISSION else None


def _falsify_mission(folder: RunFolder, runs: int, seed: int, as_json: bool) -> int | None:
    """Attack every leg, and every joint from the corners of the leg before it."""
    from ..runs.missions.attacks import falsify_mission

    summary = falsify_mission(folder, runs, seed)
    print_result(summary, as_json, partial(_show_mission, summary))
    return REFUTED if summary["violated"] else None


def _show_mission(summary: dict[str, Any]) -> None:
    """Print the results of attacks on legs and joints."""
    for leg in summary["legs"]:
        echo(f"{leg['name']}: {leg['runs']} trajectories, {leg['failure'] or 'no violation'}")
        if leg["share_of_start_set"] is not None:
            share = f"{leg['share_of_start_set']:.1%} of the next leg's start set"
            echo(f"{leg['name']}: {leg['attacks']} attacks on the joint reach {share}")
    echo("VIOLATED" if summary["violated"] else "No violation.")


@verb("replay")
def replay_command(
    case: str = Argument(..., metavar="CASE", help="A case file saved by `polaris falsify`."),
    code: str | None = Option(None, metavar="DIR", help="Flight code to fly, from polaris export c."),
) -> int | None:
    """Fly a saved case again and print the limit it violates and the time."""
    from ..report.sentences import limit_words
    from ..runs.case import replay
    from ..simulation.on_board import FlightCode

    failure, scenario = replay(case, None if code is None else FlightCode(code))
    failure = failure and replace(failure, limit=limit_words(failure.limit))
    echo(f"{scenario.name}: {failure or 'no violation in this case'}")
    return REFUTED if failure is not None else None


@verb("verify")
def verify(
    run: str = Argument(..., metavar="RUN", help="A run folder, or a certificate file."),
    code: str | None = Option(None, metavar="DIR", help="Flight code to check too, from polaris export c."),
) -> int:
    """Check the certificate of a run with the independent checker.

    Exit codes: 0 VERIFIED, 5 REJECTED, 6 UNKNOWN, 7 STATISTICAL, 2 nothing to check.
    """
    from ..certificate.__main__ import main
    from ..model.errors import ScenarioError

    place = Path(run)
    if not (place / "certificate.json" if place.is_dir() else place).is_file():
        problem = "it has no certificate.json" if place.is_dir() else "no such file or folder exists"
        raise ScenarioError("run", run, f"must be a run folder or a certificate file, but {problem}")
    return main([run] if code is None else [run, "--code", code])


def show_falsification(name: str, attack: Falsification) -> None:
    """Print the least margin of every limit beside the proven one, and a violation if there is one."""
    from ..report.scene.palette import input_labels
    from ..report.sentences import side_words
    from ..synthesis.safety.recoverable import directed

    summary, safety = attack.summary(), attack.schedule.safety
    system, unsafe = safety.problem.system, safety.clearance.unsafe
    words, thrust = side_words(unsafe, system), input_labels(system)[0] == "Thrust (N)"
    width = max(len(words.get(each, each)) for each in attack.names)
    echo(f"{name}: {summary['runs']} trajectories, {summary['runs_per_s']:.0f} per second")
    echo(f"{'limit':{width}} unit {'least flown':>13} {'proven':>11} {'proven/least':>13} {'at':>9}")
    for row in summary["limits"]:
        unit = "m" if row["limit"] in words else "N" if thrust else "-"
        proven = directed(row["proven"], ".4g") if math.isfinite(row["proven"]) else "nothing"
        share = f"{row['proven_share']:.0%}" if math.isfinite(row["proven_share"]) else "-"
        limit = words.get(row["limit"], row["limit"])
        echo(f"{limit:{width}} {unit:4} {row['least']:13.4g} {proven:>11} {share:>13} {row['time_s']:7g} s")
    proven = directed(summary["delta_v_proven_m_s"], ".4g", up=True)
    echo(f"delta-v until T: at most {summary['delta_v_m_s']:.4g} m/s flown, bound {proven} m/s proven")
    failure = attack.failure
    failure = failure and replace(failure, limit=words.get(failure.limit, failure.limit))
    echo(f"VIOLATED: {failure}" if failure else "No violation.")


def _show_within(summary: dict[str, Any]) -> None:
    """Print the parts of the bound within a distance, and the declared disturbance bound."""
    within = f"within {summary['within_m']:g} m [m/s^2]"
    echo(f"{summary['scenario']}: acceleration neglected by the linear model {within}")
    _show_parts(summary, "")


def _show_parts(summary: dict[str, Any], sampled: str) -> None:
    for name, value in summary["parts_m_s2"].items():
        echo(f"  {name.replace('_', ' '):16} {value:9.3g}")
    echo(f"  {'bound':16} {summary['bound_m_s2']:9.3g}{sampled}")
    covers = "covers it" if summary["bound_m_s2"] <= summary["declared_m_s2"] else "TOO SMALL"
    echo(f"  {'declared':16} {summary['declared_m_s2']:9.3g}   {covers}")


def _show_model_error(error: ModelError) -> None:
    """Print the parts of the bound, the declared bound, and the place and time of the largest value."""
    summary = error.summary()
    worst = summary["worst"]
    echo(f"{summary['scenario']}: acceleration neglected by the linear model along the schedule [m/s^2]")
    _show_parts(summary, f"   (sampled: {summary['sampled_share']:.0%} of it)")
    echo(
        f"Largest at t = {worst['time_s']:g} s under {worst['controller']}, within"
        f" {worst['distance_m']:.0f} m of the target, {worst['radial_m']:.0f} m radially,"
        f" at up to {worst['speed_m_s']:.2f} m/s."
    )
    for name, time in summary["satellites_covered_until_s"].items():
        until = "for as long as it is perceived" if time is None else f"until t = {time:g} s"
        echo(f"The declared motion of {name} covers its own model error {until}.")
