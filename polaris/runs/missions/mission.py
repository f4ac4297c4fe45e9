"""Run folders of missions.

================== ==================================================================================
scenario.toml      the mission, with the overrides applied
1-NAME, 2-NAME ... the run folder of every leg (`polaris.runs.schedule`)
trace.npz          simulated flights of all legs from end to end
certificate.json   what `polaris verify` checks: digests of the legs, joints, sums
summary.json       the same for people, statistics of the flights, times
================== ==================================================================================
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ...certificate.assumptions import hand_over
from ...certificate.files.document import canonical
from ...certificate.files.document import digest as digest_of
from ...certificate.mission import FORMAT, PLANT, SCENARIO
from ...model.errors import ScenarioError, SynthesisInfeasible
from ...scenario.mission import MissionScenario, moves
from ...scenario.tables.schedule import InitialBox
from ...simulation.metrics import finite
from ...simulation.mission import MissionFlights, fly_on
from ...synthesis.legs.joint import Joint, joint, turn_periods
from ...synthesis.schedule.schedule import Schedule
from ..files.arrays import read_arrays
from ..files.controllers import system_table
from ..files.folder import RunFolder, RunKind, read_json, write_folder
from ..files.ownership import sha256
from ..files.tables import strict, write_text
from ..schedule import SCHEDULE, FlownSchedule, fly_schedule, guarantee
from ..stages import Stages

MARGIN = 1e-9  # share by which sums are raised: the checker adds in another order


@dataclass(frozen=True, eq=False)
class MissionData:
    """Plot data of a mission: claims of its certificate, runs of its legs, flights of all of them."""

    certificate: dict[str, Any]
    legs: tuple[RunFolder, ...]
    flown: MissionFlights


@dataclass(frozen=True, eq=False)
class FlownMission:
    """Legs, joints between them, when each leg is left [s], and simulated flights of all."""

    legs: Sequence[FlownSchedule]
    joints: Sequence[Joint]
    leaves: Sequence[float]
    flown: MissionFlights


def fly_mission(mission: MissionScenario, stages: Stages) -> FlownMission:
    """Synthesise every leg, prove every joint, and fly the mission from end to end in simulation."""
    scenarios, legs, joints, leaves = mission.legs(), list[FlownSchedule](), list[Joint](), list[float]()
    _check_craft([strict(system_table(each.problem()), float.hex) for each in scenarios])
    for i, scenario in enumerate(scenarios):
        try:
            legs.append(fly_schedule(scenario, stages))
        except SynthesisInfeasible as error:
            raise type(error)(f"leg {scenario.name}: {error}") from error
        schedule = legs[-1].schedule
        h, T = schedule.safety.tracking.flow.h, scenario.steps * scenario.step
        stay = round(mission.model.legs[i].stay_s / h)
        if i + 1 == len(scenarios):
            leaves.append(T + stay * h)
            break
        box = mission.model.legs[i + 1].initial_set
        assert isinstance(box, InitialBox)  # checked on construction
        only_node = stay if mission.fixed(i) else None
        leg_joint = joint(schedule, np.array(box.center), np.array(box.half_widths), only_node)
        end = (schedule.safety.reference.cells - scenario.steps) * schedule.safety.clearance.q
        node = leg_joint.nodes(turn_periods(schedule), end, stay)
        label = f"from leg {scenario.name} to {scenarios[i + 1].name}"
        if node is None:
            raise SynthesisInfeasible(f"{label}: {missing(leg_joint, schedule)}")
        if not np.all(leg_joint.half_widths > 0):
            raise SynthesisInfeasible(f"{label}: the errors of estimates must be smaller than the GO box")
        joints.append(leg_joint)
        leaves.append(T + node * h)
    with stages.stage("mission"):
        plan = mission.model.legs[0].simulation
        flights = fly_on([each.schedule for each in legs], leaves, min(plan.runs, MOST_RUNS), plan.seed)
    return FlownMission(legs, joints, leaves, flights)


def _check_craft(systems: Sequence[Mapping[str, Any]]) -> None:
    """Refuse legs of two plants and, where a loop remembers more than the state's error, of two systems."""
    remembers = any({"timing", "observer"} & set(each) for each in systems)
    for i, (one, two) in enumerate(pairwise(systems), 1):
        for key in sorted({*one, *two}) if remembers else PLANT:
            if one.get(key) != two.get(key):
                rule = f"must have the system of the leg before it, but {key} differs"
                raise ScenarioError(f"legs[{i}]", key, rule + ", and its loop remembers" * (key not in PLANT))
        if any("initial" in each.get("observer", {}) for each in (one, two)):
            rule = "must not be given in a mission: it applies to the first leg only"
            raise ScenarioError(f"legs[{i}].navigation.measurement.initial", "a table", rule)


MOST_RUNS = 20  # flights from end to end that are kept


def _claims(mission: MissionScenario, outcome: FlownMission) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return the claims on the mission, and on each leg but for its digest."""
    legs, total = list[dict[str, Any]](), 0.0
    for i, (leg, leaves) in enumerate(zip(outcome.legs, outcome.leaves, strict=True)):
        claim, schedule, passive = guarantee(leg.schedule), leg.schedule, leg.schedule.passive
        goal, upkeep, system = claim["goal"], claim["upkeep"], schedule.safety.problem.system
        drift = passive if passive is not None and np.all(passive.clear) else None
        delta_v = np.inf
        if goal["reached"] is True and leaves <= goal["by_s"]:
            delta_v = goal["delta_v_max_m_s"]
        elif upkeep is not None:
            waited = max(leaves - upkeep["settled_s"], 0.0)
            delta_v = upkeep["until_settled_m_s"] + waited * upkeep["rate_m_s2"]
        delta_v = (delta_v + (system.carried_impulse / system.mass if i else 0.0)) * (1 + MARGIN)
        total += delta_v
        row = {
            "name": mission.model.legs[i].name,
            "leaves_s": leaves,
            "delta_v_max_m_s": delta_v,
            "waiting_m_s2": None if upkeep is None else upkeep["rate_m_s2"] * (1 + MARGIN),
            "safe_until_s": claim["until_s"],
            "drift_s": None if drift is None else drift.flight.abort.horizon,
        }
        legs.append(row)
    joints = [
        {"center": each.center, "half_widths": each.half_widths, "first": each.first, "later": each.later}
        | {"assured": each.assured}
        for each in outcome.joints
    ]
    moving = any(map(moves, mission.model.legs))
    faulty = any(each.schedule.safety.problem.allocation is not None for each in outcome.legs)
    claims = {"joints": joints, "delta_v_max_m_s": total * (1 + MARGIN)}
    return claims | {"assumptions": list(hand_over(moving, faulty))}, legs


def folders(mission: MissionScenario) -> list[str]:
    """Return the names of the legs' run folders."""
    return [f"{i}-{leg.name}" for i, leg in enumerate(mission.model.legs, 1)]


def _write(folder: Path, mission: MissionScenario, outcome: FlownMission) -> None:
    claims, legs = _claims(mission, outcome)
    for name, scenario, leg, claim in zip(folders(mission), mission.legs(), outcome.legs, legs, strict=True):
        write_folder(folder / name, SCHEDULE, scenario, leg)
        claim["digest"] = read_json(folder / name / "certificate.json")["digest"]
    np.savez_compressed(folder / "trace.npz", **vars(outcome.flown))
    artefacts = {name: sha256(folder / name) for name in (SCENARIO, "trace.npz")}
    data = strict({"format": FORMAT, "schema_version": 1, "artefacts": artefacts, "legs": legs, **claims})
    data["digest"] = digest_of(data)
    write_text(folder / "certificate.json", canonical(data) + "\n")


def _summary(mission: MissionScenario, outcome: FlownMission, seconds: Mapping[str, float]) -> dict[str, Any]:
    """Contents of ``summary.json``, whose claims are compared with the certificate's."""
    claims, legs = _claims(mission, outcome)
    clocks = list[dict[str, float | None]]()
    for schedule in (each.schedule for each in outcome.legs):
        problem, h = schedule.safety.problem, schedule.safety.tracking.flow.h
        turn = finite(turn_periods(schedule) * h)
        clocks.append({"horizon_s": problem.K * problem.delta, "period_s": h, "turn_s": turn})
    names = list(outcome.legs[0].schedule.safety.problem.system.state_names)
    data = {"legs": legs, **claims, "states": names, "clocks": clocks}
    return {"mission": data, "flown": outcome.flown.summary(), "seconds": dict(seconds)}


def _read(folder: Path, mission: MissionScenario) -> MissionData:
    data = read_json(folder / "certificate.json")
    legs = [
        RunFolder(folder / name, leg, SCHEDULE)
        for name, leg in zip(folders(mission), mission.legs(), strict=True)
    ]
    return MissionData(data, tuple(legs), MissionFlights(**read_arrays(folder / "trace.npz")))


MISSION = RunKind(
    "mission", (SCENARIO, "certificate.json", "trace.npz"), _write, _summary, _read, fly_mission
)
"""Run folder of a mission."""


def missing(leg_joint: Joint, schedule: Schedule) -> str:
    """Say which coordinate needs most of the next leg's start set at the node that comes nearest."""
    share, row, node = leg_joint.nearest
    names = schedule.safety.problem.system.state_names
    name, instant = names[row % len(names)], f"at the best node, {node} periods after the horizon"
    detail = f"{instant}, {name} needs {share:.0%} of the half-width; widen it, or raise stay_s"
    return f"S is not proven to be in the next leg's start set at any node of GO; {detail}"
