"""Scenarios of missions: legs, each a scenario of a schedule, that follow one another from a GO on."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..model import keys as f
from ..model.errors import ScenarioError
from ..model.scene.turning import rotate
from .base import SCHEDULE, Scenario, cached
from .reading import parse_toml, write_toml
from .schedule import ScheduleScenario
from .tables.fields import Head, unit, whole_parts
from .tables.schedule import InitialBox, ScenarioModel

OWN = ("kind", "legs")  # keys at the top that no leg takes over
OF_MISSION = ("stay_s",)  # keys of a leg that are the mission's


class LegModel(ScenarioModel):
    """One leg: a whole scenario of a schedule, and when the mission goes on."""

    stay_s: f.NonNegative = unit("s", default=0.0)
    """Planned time from the end of the leg's horizon until GO for the next one, a whole number of control
    periods; S flies. Where a later leg has sets that move or turn, GO is given at this instant or never."""


class MissionModel(Head):
    """A mission file: tables that all legs share, and under `legs` those in which they differ."""

    kind: Literal["mission"] = unit("-", "Legs that follow one another.")
    legs: tuple[LegModel, ...] = unit("-", "The legs in order.", min_length=2, max_length=32)


def leg_document(mission: Mapping[str, Any], leg: Mapping[str, Any]) -> dict[str, Any]:
    """Return the document of a leg: tables of its own stand in place of those that all legs share."""
    shared = {key: value for key, value in mission.items() if key not in OWN}
    head = {"title": f"{mission.get('title', '')}: {leg.get('name', '')}"[:200], "description": ""}
    return copy.deepcopy({**shared, **head, **leg})


def moves(leg: LegModel) -> bool:
    """Return True if any set of a leg moves or turns."""
    sets = (each.model_dump() for each in (*leg.obstacles, *leg.keep_in))
    return any(
        each["kind"] in ("satellite", "turning") or any(each.get("velocity_m_s") or ()) for each in sets
    )


class MissionScenario(Scenario):
    """A mission; see `Scenario`."""

    model: MissionModel
    MODEL = MissionModel

    @classmethod
    def with_sources(
        cls, document: Mapping[str, Any], folder: Path | None, source: str | None
    ) -> tuple[Mapping[str, Any], tuple[str, ...]]:
        """Return the document with every leg whole, sources of their numbers replaced by the numbers."""
        legs, lines = document.get("legs"), dict[str, None]()
        if not isinstance(legs, list) or not all(isinstance(leg, Mapping) for leg in legs):
            return document, ()  # refused by the model
        full_legs = []
        for leg in legs:
            full, derived = ScheduleScenario.with_sources(leg_document(document, leg), folder, source)
            full_legs.append(dict(full))
            lines |= dict.fromkeys(derived)
        head = {key: document[key] for key in (*Head.model_fields, "kind") if key in document}
        return {**head, "legs": full_legs}, tuple(lines)

    def _check(self) -> None:
        legs, names = self.legs(), [leg.name for leg in self.model.legs]
        for i, name in enumerate(names):
            if name in names[:i]:
                raise ScenarioError(f"legs[{i}].name", name, "must differ from the names of the other legs")
        for i, (leg, scenario) in enumerate(zip(self.model.legs, legs, strict=True)):
            at = f"legs[{i}]"
            for path in (each.path for each in leg.experimental if each.kind == "neural"):
                if path != Path(path).name:
                    rule = "must lie beside the mission's file"
                    raise ScenarioError(f"{at}.experimental", path, rule)
            if any(each.kind == "black_box" for each in leg.experimental):
                raise ScenarioError(f"{at}.experimental", leg.name, "must have no black boxes in a mission")
            if scenario.problem().system.transients:
                rule = "must be known at once in a mission, as a late one may last across a hand-over"
                raise ScenarioError(f"{at}.faults", leg.name, rule)
            if i and not isinstance(leg.initial_set, InitialBox):
                rule = "must be 'box' from the second leg on, as it is the GO box"
                raise ScenarioError(f"{at}.initial_set.kind", leg.initial_set.kind, rule)
            if whole_parts(leg.stay_s, scenario.period()) is None and leg.stay_s:
                rule = f"must be a whole number of control periods of {scenario.period():g} s"
                raise ScenarioError(f"{at}.stay_s", leg.stay_s, rule)
            if i and any(each.kind == "satellite" for each in leg.obstacles):
                rule = "must be in the first leg only, as its motion is not bounded over later legs"
                raise ScenarioError(f"{at}.obstacles", "satellite", rule)

    def outline(self) -> str:
        """Describe the legs on one line."""
        return ", then ".join(f"{leg.name} ({leg.horizon.duration_s:g} s)" for leg in self.model.legs)

    def starts(self, i: int) -> float:
        """Return when a leg starts as planned [s]."""
        return sum(leg.horizon.duration_s + leg.stay_s for leg in self.model.legs[:i])

    def fixed(self, i: int) -> bool:
        """Return True if GO after a leg is given at the planned instant or never: later sets move."""
        return any(map(moves, self.model.legs[i + 1 :]))

    @cached
    def legs(self) -> tuple[ScheduleScenario, ...]:
        """Return the legs' scenarios; sets that move are where they are when a leg starts as planned."""
        document = self.to_dict() if self.text is None else parse_toml(self.text, self.source or "mission")
        return tuple(self._leg(leg_document(document, leg), i) for i, leg in enumerate(document["legs"]))

    def _leg(self, document: dict[str, Any], i: int) -> ScheduleScenario:
        for key in OF_MISSION:
            document.pop(key, None)
        for each in (*document.get("obstacles", ()), *document.get("keep_in", ())):
            if i and (each.get("kind") == "turning" or any(each.get("velocity_m_s") or ())):
                each |= advanced(each, self.starts(i))
        source = f"{self.source or 'mission'}, leg {document.get('name')}"
        text = None if self.text is None else write_toml(document)
        scenario: ScheduleScenario = ScheduleScenario.from_dict(
            document, source, text=text, folder=self.folder
        )
        assert scenario.kind == SCHEDULE
        return scenario

    def files(self) -> list[Path]:
        """Files besides its own that it names."""
        return sorted({file for leg in self.legs() for file in leg.files()})


def advanced(obstacle: Mapping[str, Any], t: float) -> dict[str, Any]:
    """Return the keys of the table of a set that moves or turns that say where it is at a time [s]."""
    if obstacle["kind"] == "turning":
        angle, drift = obstacle["rate_rad_s"] * t, obstacle.get("rate_error_rad_s", 0.0) * t
        normals = np.add(*rotate(np.array(obstacle["normals"], float), obstacle.get("axis"), np.array(angle)))
        error = obstacle.get("angle_error_deg", 0.0) + math.degrees(drift)
        return {"normals": normals.tolist(), "angle_error_deg": error}
    v = obstacle["velocity_m_s"]
    if obstacle["kind"] == "polytope":
        speeds = [sum(a * x for a, x in zip(row, v, strict=True)) for row in obstacle["normals"]]
        return {"offsets_m": [b + a * t for b, a in zip(obstacle["offsets_m"], speeds, strict=True)]}
    return {"center_m": [c + x * t for c, x in zip(obstacle["center_m"], v, strict=True)]}
