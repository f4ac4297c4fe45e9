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
    from .inspection import InspectionScenario


def check(scenario: InspectionScenario) -> None:
    """Run every check.

    Raises
    ------
    ScenarioError
        At the first rule that is broken.
    """
    model = scenario.model
    if isinstance(model, models.MonteCarloModel):
        _check_time("campaign", model.campaign.duration_s, model.campaign.period_s)
        _check_studies(model)
    else:
        _check_time("flight", model.flight.duration_s, model.flight.period_s)
    q = scenario.inspection()
    if isinstance(model, models.FuelLimitModel):
        _check_fuel(scenario, model, q)
        return
    if isinstance(model, models.InspectionModel):
        _check_states(model)
        _check_phases(model)
    scenario.strengthening()
    _check_filters(scenario)
    if isinstance(model, models.InspectionModel) and isinstance(model.initial, models.InitialStates):
        _check_start(scenario.families(), model.initial)


def _check_filters(scenario: InspectionScenario) -> None:
    """Build every filter once: the conditions between samples bound the control period."""
    model = scenario.model
    if isinstance(model, models.MonteCarloModel):
        named: list[tuple[str, FlightFilter]] = [
            (f"studies[{k}].filter", study.filter) for k, study in enumerate(model.studies)
        ]
        table, period = "campaign", model.campaign.period_s
    else:
        assert isinstance(model, models.InspectionModel)
        named, table, period = [("filter", model.filter)], "flight", model.flight.period_s
    for path, spec in named:
        if len(set(spec.without)) == len(FAMILY_NAMES):
            raise ScenarioError(f"{path}.without", list(spec.without), "must leave something to enforce")
        try:
            scenario.filter(spec, period)
        except ScenarioError as error:
            field = f"{table}.period_s" if error.field == "period" else f"{path}.{error.field}"
            raise ScenarioError(field, error.given, error.rule) from error


def _check_fuel(scenario: InspectionScenario, model: models.FuelLimitModel, q: Inspection) -> None:
    from ..runs.fuel_limit import backup_law

    if len(model.initial_state) != 6:
        raise ScenarioError("initial_state", list(model.initial_state), "must have 6 numbers")
    distance = float(np.linalg.norm(model.initial_state[:3]))
    if distance <= q.separation:
        rule = f"must be farther from the chief than {q.separation:g} m, not {distance:.3g} m"
        raise ScenarioError("initial_state", list(model.initial_state), rule)
    if model.fuel.spent_m_s > q.delta_v_max:
        rule = f"must not exceed the limit, {q.delta_v_max:g} m/s"
        raise ScenarioError("fuel.spent_m_s", model.fuel.spent_m_s, rule)
    backup_law(scenario)


def _check_time(table: str, duration: float, period: float) -> None:
    count = whole_parts(duration, period)
    if not count:
        raise ScenarioError(f"{table}.period_s", period, f"must divide duration_s = {duration:g} s")
    if count > models.MOST_PERIODS:
        rule = f"must give at most {models.MOST_PERIODS} periods, not {count}"
        raise ScenarioError(f"{table}.period_s", period, rule)


def _check_studies(model: models.MonteCarloModel) -> None:
    names = [study.name for study in model.studies]
    for k, name in enumerate(names):
        if name in names[:k]:
            raise ScenarioError(f"studies[{k}].name", name, "must differ from those before it")


def _check_states(model: models.InspectionModel) -> None:
    if isinstance(model.initial, models.InitialStates):
        for k, state in enumerate(model.initial.states):
            if len(state) != 6:
                raise ScenarioError(f"initial.states[{k}]", list(state), "must have 6 numbers")


def _check_phases(model: models.InspectionModel) -> None:
    starts = [phase.start_s for phase in model.primary]
    if starts[0] != 0:
        raise ScenarioError("primary[0].start_s", starts[0], "must be 0")
    for k in range(1, len(starts)):
        if starts[k] <= starts[k - 1]:
            rule = f"must be later than the phase before it, {starts[k - 1]:g} s"
            raise ScenarioError(f"primary[{k}].start_s", starts[k], rule)


def _check_start(families: Families, given: models.InitialStates) -> None:
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
