"""The rules that join several fields of a scenario of the inspection problem."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..inspection.inspection import Inspection
from ..model.errors import ScenarioError
from . import inspection_tables as models
from .build import whole_parts
from .filter_tables import FAMILY_NAMES, FlightFilter

if TYPE_CHECKING:
    from ..inspection.constraints.families import Families


def check_left_out(path: str, spec: FlightFilter) -> None:
    """A filter enforces something."""
    if len(set(spec.without)) == len(FAMILY_NAMES):
        raise ScenarioError(f"{path}.without", list(spec.without), "must leave something to enforce")


def check_fuel(model: models.FuelLimitModel, q: Inspection) -> None:
    """Where a flight into the fuel limit starts, and with how much."""
    if len(model.initial_state) != 6:
        raise ScenarioError("initial_state", list(model.initial_state), "must have 6 numbers")
    distance = float(np.linalg.norm(model.initial_state[:3]))
    if distance <= q.separation:
        rule = f"must be farther from the chief than {q.separation:g} m, not {distance:.3g} m"
        raise ScenarioError("initial_state", list(model.initial_state), rule)
    if model.fuel.spent_m_s > q.delta_v_max:
        rule = f"must not exceed the limit, {q.delta_v_max:g} m/s"
        raise ScenarioError("fuel.spent_m_s", model.fuel.spent_m_s, rule)


def check_time(table: str, duration: float, period: float) -> None:
    """Periods divide the flight, and there are not too many."""
    count = whole_parts(duration, period)
    if not count:
        raise ScenarioError(f"{table}.period_s", period, f"must divide duration_s = {duration:g} s")
    if count > models.MOST_PERIODS:
        rule = f"must give at most {models.MOST_PERIODS} periods, not {count}"
        raise ScenarioError(f"{table}.period_s", period, rule)


def check_studies(model: models.MonteCarloModel) -> None:
    """Studies have names of their own."""
    names = [study.name for study in model.studies]
    for k, name in enumerate(names):
        if name in names[:k]:
            raise ScenarioError(f"studies[{k}].name", name, "must differ from those before it")


def check_states(given: models.InitialStates) -> None:
    """Six numbers for each deputy."""
    for k, state in enumerate(given.states):
        if len(state) != 6:
            raise ScenarioError(f"initial.states[{k}]", list(state), "must have 6 numbers")


def check_phases(model: models.InspectionModel) -> None:
    """The phases of the primary controller follow one another from 0 on."""
    starts = [phase.start_s for phase in model.primary]
    if starts[0] != 0:
        raise ScenarioError("primary[0].start_s", starts[0], "must be 0")
    for k in range(1, len(starts)):
        if starts[k] <= starts[k - 1]:
            rule = f"must be later than the phase before it, {starts[k - 1]:g} s"
            raise ScenarioError(f"primary[{k}].start_s", starts[k], rule)


def check_start(families: Families, given: models.InitialStates) -> None:
    """Every constraint must hold at the start: a filter keeps a flight safe, it does not make it so."""
    from ..inspection.constraints.allowable_set import allowable

    q = families.inspection
    x, sun = np.array(given.states, dtype=float), np.radians(given.sun_angle_deg)
    broken: list[tuple[str, int, float]] = []
    for name, values in allowable(q, x, sun).items():
        who = q.pairs[:, 0] if name in ("phi2", "phi5") else np.arange(len(x))
        broken += [(name, int(i), float(v)) for i, v in zip(who, values, strict=True) if not v >= 0]
    h = families(x[None], np.array([sun])).h[0]
    rows = np.flatnonzero(~(h >= 0))
    broken += [(f"{families.labels[k]} ({families.family[k]})", int(families.first[k]), h[k]) for k in rows]
    if broken:
        name, i, value = broken[0]
        rule = f"must satisfy every constraint; {name} is {value:.3g} at the start"
        raise ScenarioError(f"initial.states[{i}]", list(given.states[i]), rule)
