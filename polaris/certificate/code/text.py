"""The C text of the flight code, from numbers alone: templates beside this file, and tables."""

import re
from ctypes import c_float
from dataclasses import dataclass, field, fields
from math import prod
from pathlib import Path
from typing import Any

FARTHEST = 1e6  # largest plausible entry of a state, in its unit
HEADERS = (
    "assert|complex|ctype|errno|features|fenv|float|inttypes|limits|locale|math|setjmp|signal|stdarg|stdbool"
    "|stddef|stdint|stdio|stdlib|string|tgmath|time|wchar|wctype"
)
PREFIX = re.compile(rf"(?!({HEADERS})$)[a-z][a-z0-9_]{{0,19}}")  # C99 tells names apart by 31 characters
PRECISIONS = {"double": "DBL_MAX", "float": "FLT_MAX"}
HEAD = re.compile(r'_CERTIFICATE "([0-9a-f]{64})"\n')
SIZES = "N", "M", "Q", "STEPS", "CELLS", "COVERED"
ONLINE = "KINDS", "FACETS", "LAGS", "AHEAD"  # sizes of the online monitor's tables
OBSERVER = "OUTPUTS", "SENT", "UPDATES"  # of the observer's
CENTRE = 0.5  # share of S's gain about which errors of its commands are bounded, whoever flies
FREE = 2.0**100  # clearance that limits nothing
KEEP = 0.9  # share of the clearance that U may need where S has flown, as 1 - `Monitor.reentry`

Table = Any  # nested lists of floats


@dataclass(frozen=True)
class Tables:
    """Numbers of the flight code: K steps of q periods, R cells of the reference, n states, m inputs.

    Attributes
    ----------
    covered : int
        Control periods that the proof covers.
    modes : list, shape (K,)
    waypoints : list, shape (R, n)
        Reference at the start of every cell.
    feed : list, shape (K, m)
        Input of the reference [N].
    moved, pushed : list, shapes (q, n, n) and (q, n, m)
        Transition from the start of a cell to each of its nodes, and what a unit input adds.
    gain : list, shape (m, n)
    limit : list, shape (m,)
        Thrust limits [N].
    range : list, shape (n,)
        Largest entries of a state for which rounding is bounded.
    rounding : float
        Bound on what rounding changes of a command then [N].
    rows : list, shape (r, n)
        Of the online monitor, empty without it, as are all below: limits of recoverable sets, facets first,
        one of rows that are opposite.
    facets : int
        Number of rows that are facets.
    held, force, loop : list, shapes (n, n), (n, m) and (n, n)
        Transition over a period, what a unit input adds, and the transition under S.
    apart : list, shape (n,)
        Largest errors for which U may fly.
    booked, sized : list, shape (l, r)
        Tightening of a limit so many periods after a decision, rounding included, and its increase as the
        error grows from none to the largest.
    clearance : list, shape (c, r, 4)
        Clearance of every cell ahead along a row and against it: at its start, and more in every period.
    seen : list, shape (o, n)
        Of the observer, empty without it, as are all below: what is measured, by the state predicted for now.
    later : list, shape (d, o, m)
        What of it a unit of the command of 1, 2, ... periods before makes that the measurement does not show.
    updates : list, shape (k, n, o)
        What a unit of a difference from what is predicted adds to the state, after 0, 1, ... missed periods.
    heard : list, shape (o,)
        Largest measurements for which rounding is bounded.
    """

    covered: int
    modes: list[int]
    waypoints: Table
    feed: Table
    moved: Table
    pushed: Table
    gain: Table
    limit: Table
    range: Table
    rounding: float = 0.0
    facets: int = 0
    rows: Table = field(default_factory=list)
    held: Table = field(default_factory=list)
    force: Table = field(default_factory=list)
    loop: Table = field(default_factory=list)
    apart: Table = field(default_factory=list)
    booked: Table = field(default_factory=list)
    sized: Table = field(default_factory=list)
    clearance: Table = field(default_factory=list)
    seen: Table = field(default_factory=list)
    later: Table = field(default_factory=list)
    updates: Table = field(default_factory=list)
    heard: Table = field(default_factory=list)

    @property
    def sizes(self) -> dict[str, int]:
        """Sizes by their names in the templates."""
        counts = len(self.waypoints[0]), len(self.limit), len(self.moved), len(self.modes)
        sizes = dict(zip(SIZES, (*counts, len(self.waypoints), self.covered), strict=True))
        online = len(self.rows), self.facets, len(self.booked), len(self.clearance)
        observer = len(self.seen), len(self.later), len(self.updates)
        sizes |= dict(zip(OBSERVER, observer, strict=True)) if self.seen else {}
        return sizes | (dict(zip(ONLINE, online, strict=True)) if self.rows else {})

    def rounded(self, precision: str) -> "Tables":
        """Return the tables with every number rounded to a precision."""
        tables = {one.name: getattr(self, one.name) for one in fields(self)}
        return Tables(**{key: _rounded(value, precision) for key, value in tables.items()})


SHAPES = {
    "waypoints": ("CELLS", "N"),
    "feed": ("STEPS", "M"),
    "moved": ("Q", "N", "N"),
    "pushed": ("Q", "N", "M"),
    "gain": ("M", "N"),
    "limit": ("M",),
    "range": ("N",),
}
ONLINE_SHAPES = {
    "rows": ("KINDS", "N"),
    "held": ("N", "N"),
    "force": ("N", "M"),
    "loop": ("N", "N"),
    "apart": ("N",),
    "booked": ("LAGS", "KINDS"),
    "sized": ("LAGS", "KINDS"),
    "clearance": ("AHEAD", "KINDS", "SIDES"),
}
OBSERVER_SHAPES = {
    "held": ("N", "N"),
    "force": ("N", "M"),
    "seen": ("OUTPUTS", "N"),
    "later": ("SENT", "OUTPUTS", "M"),
    "updates": ("UPDATES", "N", "OUTPUTS"),
    "heard": ("OUTPUTS",),
}
SIDES = 4
NAMES = {"N": "STATES", "M": "INPUTS", "Q": "PARTS", "STEPS": "STEPS", "CELLS": "CELLS"}
KEY = re.compile(r"@([A-Z]+)@")
LITERAL = re.compile(r"[^\s{},]+")


def rounded(x: float, precision: str) -> float:
    """Round a number to a precision; beyond its largest it is infinite."""
    return c_float(x).value if precision == "float" else x


def _rounded(value: Table, precision: str) -> Table:
    if isinstance(value, list):
        return [_rounded(item, precision) for item in value]
    return value if isinstance(value, int) else rounded(value, precision)


def literal(x: float, precision: str) -> str:
    """Exact C99 literal of a number of a precision."""
    return float(x).hex() + "f" * (precision == "float")


def _braces(value: Table, precision: str) -> str:
    if not isinstance(value, list):
        return literal(value, precision)
    parts = [_braces(item, precision) for item in value]
    return "{" + (",\n ".join(parts) if isinstance(value[0], list) else ", ".join(parts)) + "}"


def files(tables: Tables, prefix: str, precision: str, digest: str) -> dict[str, str]:
    """Return the texts of the header and the source by their names, of tables rounded to the precision."""
    guard, parts, online, has_observer = prefix.upper(), [], bool(tables.rows), bool(tables.seen)
    for name, shape in _shapes(online, has_observer).items():
        size = "".join(f"[{guard}_{NAMES.get(one, one)}]" for one in shape)
        body = _braces(getattr(tables, name), precision)
        parts.append(f"static const {prefix}_real {name}{size} = {body};")
    steps = ", ".join(f"{mode}U" for mode in tables.modes)
    parts.append(f"static const uint8_t modes[{guard}_STEPS] = {{{steps}}};")
    values: dict[str, Any] = {
        "PREFIX": prefix,
        "GUARD": guard,
        "REAL": precision,
        "MOST": PRECISIONS[precision],
    }
    values |= {"DIGEST": digest, "TABLES": "\n\n".join(parts), **tables.sizes}
    n, m, *_ = tables.sizes.values()
    outputs, sent = len(tables.seen), len(tables.later)
    filtered = has_observer * (n * (n + m) + outputs * (2 * n + sent * m))
    counts = {"PRODUCTS": n * (n + 2 * m) + filtered, "SUMS": n * (n + 2 * m + 1) + m + filtered}
    values |= counts | {"QUOTIENTS": m}  # of `estimate`, `safety` and `answer`
    reals = {"ZERO": 0.0, "ONE": 1.0, "FARTHEST": FARTHEST, "ROUNDING": tables.rounding, "KEEP": KEEP}
    values |= {key: literal(x, precision) for key, x in reals.items()}
    texts = dict[str, str]()
    for kind in ("h", "c"):
        text = template(f"step.{kind}").replace("@ONLINE@", template(f"online.{kind}") if online else "")
        parts = template("observer.c" if has_observer else "estimate.c").split("@PART@\n")
        for place, part in zip(("FAULT", "INPUT", "MEMORY", "START", "ESTIMATE"), parts, strict=True):
            text = text.replace(f"@{place}@\n", part)
        texts[f"{prefix}.{kind}"] = KEY.sub(lambda key: str(values[key[1]]), text)
    return texts


def _shapes(online: bool, has_observer: bool) -> dict[str, tuple[str, ...]]:
    return SHAPES | (ONLINE_SHAPES if online else {}) | (OBSERVER_SHAPES if has_observer else {})


def template(name: str) -> str:
    """Return the text of a template."""
    return (Path(__file__).parent / name).read_text(encoding="utf-8")


def parsed(header: str, source: str, prefix: str) -> tuple[Tables, str, str]:
    """Read tables, precision and digest back; `ValueError` where these files are not exactly their text."""
    precision = next((p for p in PRECISIONS if f"typedef {p} {prefix}_real;" in header), "")
    head = HEAD.search(header)
    online = f"{prefix.upper()}_LAGS" in header
    has_observer = f"{prefix.upper()}_OUTPUTS" in header
    keys = SIZES + ONLINE * online + OBSERVER * has_observer
    sizes = {key: _size(header, f"{prefix.upper()}_{NAMES.get(key, key)}") for key in keys}
    if not precision or head is None:
        raise ValueError("the header names no precision, or no certificate")
    arrays = dict[str, Any]()
    for name, shape in _shapes(online, has_observer).items():
        texts = _literals(source, f"static const {prefix}_real {name}[")
        count = [SIDES if one == "SIDES" else sizes[one] for one in shape]
        if len(texts) != prod(count):
            raise ValueError(f"the table {name} has {len(texts)} numbers, not {prod(count)}")
        arrays[name] = _nested([_number(text, precision) for text in texts], count)
    modes = [int(text.rstrip("U")) for text in _literals(source, "static const uint8_t modes[")]
    bound = re.search(rf"#define {prefix.upper()}_ROUNDING \((\S+?)f?\)", header)
    arrays["rounding"] = _number(bound[1], precision) if bound else 0.0
    tables = Tables(covered=sizes["COVERED"], modes=modes, facets=sizes.get("FACETS", 0), **arrays)
    for name, text in files(tables, prefix, precision, head[1]).items():
        stored = header if name.endswith(".h") else source
        if stored != text:
            lines = zip(stored.splitlines(), text.splitlines(), strict=False)
            line = next((i for i, (a, b) in enumerate(lines, 1) if a != b), "the end")
            raise ValueError(f"{name} differs from the text of its numbers in line {line}")
    return tables, precision, head[1]


def _number(literal: str, precision: str) -> float:
    """Return the number that a compiler makes of a literal."""
    return rounded(float.fromhex(literal.rstrip("f")), precision)


def _size(header: str, name: str) -> int:
    match = re.search(rf"#define {name} \((\d{{1,9}})\)", header, re.ASCII)
    if match is None:
        raise ValueError(f"the header has no {name}")
    return int(match[1])


def _literals(source: str, start: str) -> list[str]:
    begin, end = source.find(start), source.find("};", source.find(start))
    if begin < 0 or end < 0:
        raise ValueError(f"there is no {start}...]")
    return LITERAL.findall(source[source.index("= {", begin) + 2 : end])


def _nested(values: list[float], shape: list[int]) -> Table:
    if len(shape) == 1:
        return values
    part = len(values) // shape[0] if shape[0] else 0
    return [_nested(values[i * part : (i + 1) * part], shape[1:]) for i in range(shape[0])]
