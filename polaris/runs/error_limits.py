"""Search for the declared errors that keep a scenario from having a safe reference, and by how much."""

import math
from bisect import bisect_left
from collections.abc import Iterator, Mapping
from typing import Any

from ..model.errors import NotCertified, ScenarioError, SynthesisInfeasible
from ..scenario.scenario import ScheduleScenario
from ..synthesis.safety.get_safety import find_safety

TABLES = ("navigation", "thrusters", "timing", "chaser")
OTHERS = ("from_s", "within_m", "directions", "thrust_max_N", "matrix")  # tables' keys of no errors
SHARES = tuple(2 ** (-i / 4) for i in range(81))  # of a bound for which a reference is sought, 1 to 1e-6

Bounds = Mapping[str, Any]  # numbers, or lists of them, by their keys in the scenario


def naming_errors(error: SynthesisInfeasible, scenario: ScheduleScenario) -> SynthesisInfeasible:
    """Return the error with the values to which each declared bound, or all together, must be lowered."""
    data = scenario.to_dict()
    bounds = {key: value for table in TABLES for key, value in _bounds(table, data.get(table))}
    if not bounds or not _solved(scenario, bounds, SHARES[-1]):
        return error
    options = [_lowered(scenario, {key: value}) for key, value in bounds.items()]
    texts = [option for option in options if option] or [_lowered(scenario, bounds)]
    relax = (
        f"{error.relax.rstrip('.')}; or declare {', or '.join(texts)}, with which a safe reference is found."
    )
    return SynthesisInfeasible(error.condition, error.shortfall, relax)


def _bounds(key: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Errors that are not zero in a part of the scenario."""
    if isinstance(value, dict):
        for name, part in value.items():
            yield from () if name in OTHERS else _bounds(f"{key}.{name}", part)
    elif isinstance(value, list) and value and isinstance(value[0], dict):
        for i, part in enumerate(value):
            yield from _bounds(f"{key}[{i}]", part)
    elif not isinstance(value, str) and any(value if isinstance(value, list) else [value]):
        yield key, value


def _less(value: Any, share: float) -> Any:
    """Return a share of a bound, rounded down to two digits; whole numbers stay whole."""
    if isinstance(value, list):
        return [_less(one, share) for one in value]
    if isinstance(value, int) or not value:
        return int(value * share)
    unit = 10.0 ** (math.floor(math.log10(value * share)) - 1)
    return float(f"{math.floor(value * share / unit) * unit:.2g}")


def _solved(scenario: ScheduleScenario, bounds: Bounds, share: float) -> bool:
    """Return True if a safe reference is found with a share of some bounds."""
    lowered = {key: _less(value, share) for key, value in bounds.items()}
    try:
        find_safety(scenario.with_overrides(lowered).problem())
    except (SynthesisInfeasible, NotCertified, ScenarioError):
        return False
    return True


def _lowered(scenario: ScheduleScenario, bounds: Bounds) -> str:
    """Describe the largest share of some bounds with which a safe reference is found; "" if with none."""
    if not _solved(scenario, bounds, SHARES[-1]):
        return ""
    last = len(SHARES) - 1
    largest = SHARES[bisect_left(SHARES, True, 1, last, key=lambda share: _solved(scenario, bounds, share))]
    return " and ".join(f"{key} = {_less(value, largest)} (not {value})" for key, value in bounds.items())
