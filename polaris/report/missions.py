"""Tables of a mission: its legs, when GO is given, and the boxes of estimates that give it."""

from collections.abc import Mapping, Sequence
from typing import Any

from ..synthesis.safety.recoverable import directed
from .tables import Cell, Table


def legs_table(summary: Mapping[str, Any]) -> Table:
    """Return the legs with the bound on the delta-v of each, and the time for which each is safe."""
    heads = ["leg", "ends at", "delta-v, at most", "while waiting", "NO-GO: safe under S", "drift clear"]
    rows, mission = [], summary["mission"]
    for leg in mission["legs"]:
        waits = "-" if leg["waiting_m_s2"] is None else f"{_up(leg['waiting_m_s2'] * 3600)} m/s per hour"
        until = "for ever" if leg["safe_until_s"] is None else f"until {leg['safe_until_s']:.6g} s"
        drift = "no claim" if leg["drift_s"] is None else f"{leg['drift_s']:.6g} s"
        texts = f"{leg['leaves_s']:.6g} s", f"{_spent(leg)} m/s", waits, until, drift
        rows.append([Cell(leg["name"], words=True), *map(Cell, texts)])
    total = [Cell("mission", words=True), *map(Cell, ("", f"{_spent(mission)} m/s", "", "", ""))]
    return Table("Legs", heads, [*rows, total])


def joint_tables(summary: Mapping[str, Any]) -> list[Table]:
    """Return the GO box of every joint: the interval of each estimated state in which GO is given."""
    mission, tables = summary["mission"], []
    for i, joint in enumerate(mission["joints"]):
        names = mission["legs"][i]["name"], mission["legs"][i + 1]["name"]
        caption = f"GO from {names[0]} to {names[1]}, {instants(joint, mission['clocks'][i])}"
        caption += "" if joint["assured"] else "; an admissible flight may be outside, which is NO-GO"
        rows = []
        for name, c, half in zip(mission["states"], joint["center"], joint["half_widths"], strict=True):
            texts = f"{c:.6g}", f"{half:.4g}", f"{c - half:.6g} to {c + half:.6g}"
            rows.append([Cell(name, words=True), *map(Cell, texts)])
        tables.append(Table(caption, ["estimated state", "center", "half-width", "GO if within"], rows))
    return tables


def instants(joint: Mapping[str, Any], clock: Mapping[str, float]) -> str:
    """Say at which instants of a leg's clock GO may be given."""
    T, h = clock["horizon_s"], clock["period_s"]
    first = [_span(T + a * h, T + b * h) for a, b in joint["first"]]
    parts = ["at " + ", ".join(first)] if first else []
    whole = clock["turn_s"] is None or any(a == 0 and b * h >= clock["turn_s"] for a, b in joint["later"])
    if joint["later"] and whole:
        parts.append("at any node after that")
    elif joint["later"]:
        spans = ", ".join(_span(a * h, b * h) for a, b in joint["later"])
        turns = f"in later revolutions of {clock['turn_s']:.6g} s, counted from {T:g} s"
        parts.append(f"{turns}, at {spans} of each")
    return " and ".join(parts)


def _span(a: float, b: float) -> str:
    return f"{a:.6g} s" if a == b else f"{a:.6g} to {b:.6g} s"


def _spent(sums: Mapping[str, Any]) -> str:
    return "no bound in" if sums["delta_v_max_m_s"] is None else _up(sums["delta_v_max_m_s"])


def _up(x: float) -> str:
    return directed(x, ".4g", up=True)


def rows_flown(summary: Mapping[str, Any]) -> Sequence[tuple[str, str]]:
    """Return statistics of simulated flights from end to end; they prove nothing."""
    flights = summary["flown"]
    shares = ", ".join(f"{share:.0%}" for share in flights["share_of_start_set"])
    distances = [distance for distance in flights["least_distance_m"] if distance is not None]
    delta_v = f"mean delta-v {sum(flights['delta_v_m_s']):.4g} m/s"
    return (
        ("Simulated flights", f"{flights['runs']} from end to end, {delta_v}"),
        ("Largest delta-v of a flight", f"{flights['delta_v_largest_m_s']:.4g} m/s"),
        ("Minimum distance", f"{min(distances):.4g} m" if distances else "no keep-out zone"),
        ("Share of the start sets used", shares),
    )
