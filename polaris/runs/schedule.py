"""Run folders of switching schedules.

================== ==================================================================================
scenario.toml      the scenario, with the overrides applied
schedule.csv/json  who flies each step, with its containment margin and what limits it
reference.csv      states and inputs of the safe reference, coasting tail included
gains.json         law, system, gains, error bounds
sets.npz           what the recoverable sets are made from
tubes.npz          reachable sets of every step
trajectories.npz   some simulated runs of S, U and Polaris
certificate.json   what `polaris verify` checks, with the hashes of the files above
summary.json       metrics, guarantee, times
figures/           PDF and PNG, drawn from the files above alone
================== ==================================================================================
"""

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..certificate.files.document import canonical
from ..model.checks import of_kind
from ..model.errors import SynthesisInfeasible
from ..planning.problem import SOLVERS
from ..scenario.scenario import ScheduleScenario
from ..simulation import baselines
from ..simulation.metrics import DEFINITIONS, finite
from ..simulation.orbit.model_error import left_out
from ..simulation.sampled import SampledSchedules, with_boxes
from ..synthesis.controllers.black_box import Ask
from ..synthesis.controllers.controllers import AffineController
from ..synthesis.controllers.neural import NeuralController
from ..synthesis.safety import get_safety
from ..synthesis.schedule import synthesize
from ..synthesis.schedule.same_system import check_safety
from ..synthesis.schedule.schedule import Schedule
from ..synthesis.schedule.share_bound import ShareBound, share_bound
from .build_plot_data import schedule_plot_data
from .certificate import hexadecimal, write_certificate
from .error_limits import naming_errors
from .fault_attribution import attribute_faults
from .files import arrays
from .files import tables as files
from .files.atomic import check_target
from .files.controllers import described, write_gains
from .files.folder import SCENARIO, Draw, RunFolder, RunKind, read_json, write_folder
from .plot_data import PlotData, SliceData
from .stages import Stages

SYNTHESIS = ("safety controller", "schedule")  # stages of the synthesis, whose parts a schedule times itself

DATA_FILES = (
    SCENARIO,
    "schedule.csv",
    "schedule.json",
    "reference.csv",
    "gains.json",
    "sets.npz",
    "tubes.npz",
    "trajectories.npz",
)


@dataclass(frozen=True, eq=False)
class FlownSchedule:
    """A schedule, the simulated runs of S, U and Polaris, and the bound that no schedule can exceed."""

    schedule: Schedule
    flown: Mapping[str, baselines.ControllerRuns]
    at_most: ShareBound = ShareBound(1.0, 1.0)
    sampled: SampledSchedules | None = None


def digest(schedule: Schedule) -> str:
    """SHA-256 of a schedule's content: modes, references, gains, limits."""
    sha = hashlib.sha256()
    safety = schedule.safety
    system = safety.problem.system
    arrays = [schedule.modes, safety.reference.chi, safety.reference.nu, safety.tracking.gain, system.u_max]
    for law in schedule.controllers:
        if isinstance(law, AffineController):
            arrays += [law.gain, law.own.chi, law.own.nu]
        elif isinstance(law, NeuralController):
            sha.update(canonical(hexadecimal(described(law))).encode())
            arrays += [law.own.chi, law.own.nu]
    fits = (getattr(step.tube, "fit", None) for step in schedule.steps)
    arrays += [fit for fit in fits if fit is not None]
    for array in arrays:
        sha.update(np.ascontiguousarray(array).tobytes())
    return sha.hexdigest()


def fly_schedule(
    scenario: ScheduleScenario, stages: Stages, boxes: Mapping[str, Ask] | None = None
) -> FlownSchedule:
    """Synthesise a schedule, prove it (or sample it, where black boxes fly), and fly it in simulation."""
    scenario.check_black_boxes(boxes)
    with stages.stage("safety controller"):
        problem = scenario.problem()
        planner = replace(problem.planner, progress=stages.planner)
        try:
            safety = get_safety.get_safety(replace(problem, planner=planner))
        except SynthesisInfeasible as error:
            raise naming_errors(error, scenario) from error
    with stages.stage("experimental controllers"):
        experimental = () if boxes else scenario.controllers(safety)
    with stages.stage("schedule"):
        counting, sampled = stages.counting("schedule: step {} of {}"), None
        if boxes:
            sampled = with_boxes(scenario, boxes, safety, counting)
            schedule = sampled.schedule
        else:
            schedule = synthesize.synthesize(scenario, safety, experimental, progress=counting, recourse=True)
    with stages.stage("bound"):
        at_most = _at_most(scenario, schedule)
    with stages.stage("simulation"):
        plan, counting = scenario.simulation, stages.counting("simulation: {} of {} runs")
        runs = baselines.compare(schedule, plan.runs, plan.seed, counting)
        return FlownSchedule(schedule, runs, at_most, sampled)


def _at_most(scenario: ScheduleScenario, schedule: Schedule) -> ShareBound:
    return share_bound(schedule, scenario.switching_rules(), scenario.model.schedule.bound_programs)


def write_run(
    out: str | Path,
    scenario: ScheduleScenario,
    schedule: Schedule,
    flown: Mapping[str, baselines.ControllerRuns] | None = None,
    *,
    draw: Draw | None = None,
) -> RunFolder:
    """Write the run folder of a schedule, replacing an older one once everything is written.

    Parameters
    ----------
    out : path
        The folder; its parents are made.
    scenario : ScheduleScenario
        What was synthesised; it is copied into the folder.
    schedule : Schedule
        Result of `synthesize` on it.
    flown : mapping, optional
        Result of `compare`; flown here as the scenario's ``[simulation]`` says if not given.
    draw
        As for `polaris.run`.

    Raises
    ------
    ScenarioError
        If `out` is something else than a run folder, or cannot be written, or the schedule is that of
        another scenario.
    """
    of_kind("scenario", scenario, ScheduleScenario, "polaris.load_scenario")
    of_kind("schedule", schedule, Schedule, "polaris.synthesize")
    check_safety(schedule.safety, scenario.problem())  # or the folder would tell of a proof of something else
    if flown is None:
        flown = baselines.compare(schedule, scenario.simulation.runs, scenario.simulation.seed)
    outcome = FlownSchedule(schedule, flown, _at_most(scenario, schedule))
    return write_folder(check_target(out, SCHEDULE.names), SCHEDULE, scenario, outcome, draw=draw)


def _write(folder: Path, scenario: ScheduleScenario, outcome: FlownSchedule) -> None:
    schedule, rules = outcome.schedule, asdict(scenario.switching_rules())
    files.write_schedule(folder, schedule, rules, guarantee(schedule))
    files.write_reference(folder / "reference.csv", schedule.safety.reference)
    write_gains(folder / "gains.json", schedule)
    flights = {key: item.flights for key, item in outcome.flown.items()}
    picture = schedule_plot_data(schedule, flights)
    assert picture.slices is not None
    np.savez(folder / "sets.npz", **arrays.set_arrays(schedule, picture.slices))
    np.savez_compressed(folder / "tubes.npz", **arrays.tube_arrays(schedule))
    np.savez(folder / "trajectories.npz", **arrays.flight_arrays(flights))
    names = [*DATA_FILES, *(file.name for file in scenario.files())]
    write_certificate(folder, schedule, scenario.name, names)


def _summary(
    scenario: ScheduleScenario, outcome: FlownSchedule, seconds: Mapping[str, float]
) -> dict[str, Any]:
    """Contents of ``summary.json``."""
    schedule, safety = outcome.schedule, outcome.schedule.safety
    plan, bound = safety.plan, asdict(outcome.at_most)
    return {
        **{key: item.metrics.summary() for key, item in outcome.flown.items()},
        "synthesis": {
            "recoverable": safety.recoverable.kind,
            "experimental_share": schedule.share(),
            **_boxes(outcome.sampled),
            "share_at_most": bound.pop("share"),
            "share_bound": bound,
            "switches": schedule.switches,
            "start_margin": safety.start_margin.value,
            "start_limit": safety.start_margin.limit,
            "planner": {
                "status": plan.status,
                "solver": plan.solver,
                "solver_name": SOLVERS[plan.solver],
                "cut_by_clock": list(safety.cut_by_clock),
                "stages": [asdict(stage) for stage in plan.stages],
                "gap": plan.gap,
                "delta_v_m_s": plan.delta_v,
                "margin_m": plan.margin,
                "size": plan.stats,
            },
            "seconds": {**_seconds(schedule, seconds), "plan_parts": plan.seconds},
        },
        "guarantee": guarantee(schedule),
        **left_out(scenario, schedule),
        "definitions": DEFINITIONS,
        "seed": scenario.simulation.seed,
    }


def _seconds(schedule: Schedule, stage_times: Mapping[str, float]) -> dict[str, float]:
    """Return wall times of the parts of the synthesis and of stages around it; they add up to ``total``."""
    stages, parts = dict(stage_times), dict(schedule.seconds)
    total, measured = stages.pop("total"), [stages.pop(name, 0.0) for name in SYNTHESIS]
    total += 0.0 if any(measured) else sum(parts.values())  # a schedule made before anything was timed
    names = (name for name in (*parts, *stages) if name != "other")
    times = {name: parts.get(name, 0.0) + stages.get(name, 0.0) for name in names}
    return {**times, "other": total - sum(times.values()), "total": total}


def _boxes(sampled: SampledSchedules | None) -> dict[str, Any]:
    """Return the share proven without asking the black boxes, and the worst flight found with them."""
    if sampled is None:
        return {}
    report, worst = None, sampled.worst
    if worst is not None:
        sets = worst.least[: len(sampled.schedule.safety.clearance.unsafe)]
        report = {
            "runs": worst.runs,
            "violated": worst.failure is not None,
            "failure": None if worst.failure is None else str(worst.failure),
            "least_m": finite(float(min(sets, default=np.inf))),
            "leave_sets": sampled.adverse,
            "repeats": sampled.repeats,
        }
    return {"proven_share": sampled.proven.share(), "worst_flight": report}


def guarantee(schedule: Schedule) -> dict[str, Any]:
    """Return the claim, until when it holds, its reason, and its assumptions."""
    end, goal, attribution = schedule.safety.end, schedule.arrival, attribute_faults(schedule)
    return {
        "kind": schedule.guarantee,
        "horizon": end.horizon,
        "until_s": end.until if np.isfinite(end.until) else None,
        "reason": end.reason,
        "assumptions": list(schedule.assumptions),
        **({"sampled_bound": asdict(schedule.sampled_bound)} if schedule.sampled_bound else {}),
        "goal": {
            "reached": goal.reached,
            "by_s": goal.by,
            "distance_m": goal.distance,
            "tolerance_m": goal.tolerance,
            "velocity_time_s": goal.velocity_time,
            "drift_m_per_orbit": goal.drift,
            "delta_v_max_m_s": goal.delta_v,
        },
        "upkeep": None if schedule.upkeep is None else schedule.upkeep.to_dict(),
        **({} if schedule.estimate is None else {"estimate": schedule.estimate}),
        **({} if schedule.passive is None else {"abort": schedule.passive.to_dict()}),
        **({"fault_attribution": attribution} if attribution else {}),
        **({} if schedule.powered is None else {"powered_abort": schedule.powered.to_dict()}),
    }


def _read(folder: Path, scenario: ScheduleScenario) -> PlotData:
    document, system = read_json(folder / "schedule.json"), scenario.system()
    steps, claim = document["steps"], document["guarantee"]
    goal = claim["goal"] if claim["kind"] == "proved" else {}
    tubes = arrays.tube_pictures(arrays.read_arrays(folder / "tubes.npz"), system.position)
    return PlotData(
        scenario.title,
        system,
        scenario.obstacles(),
        scenario.goal(),
        scenario.initial_set(),
        files.read_reference(folder / "reference.csv", system, scenario.step),
        len(steps),
        tuple(controller["name"] for controller in document["controllers"]),
        np.array(document["modes"], dtype=int),
        np.array([-np.inf if step["margin"] is None else step["margin"] for step in steps], dtype=float),
        tuple(step["limit"] for step in steps),
        arrays.read_flights(folder / "trajectories.npz"),
        slices=SliceData(**arrays.read_fields(arrays.read_arrays(folder / "sets.npz"), arrays.SLICES)),
        reached=goal.get("by_s"),
        delta_v_max=goal.get("delta_v_max_m_s"),
        tube=tubes["tube"],
        state_tube=tubes["state_tube"],
    )


SCHEDULE = RunKind("schedule", DATA_FILES, _write, _summary, _read, fly_schedule)  # run folder of a schedule
