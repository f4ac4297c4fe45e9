"""Check of flight code: its text is that of its numbers, and its numbers are those of the certificate."""

import re
from pathlib import Path

from flint import arb, arb_mat

from ..claims.coasting import exact_path
from ..claims.continuation import Continuation
from ..files.document import Document
from ..files.structure import contents
from ..kernel.balls import column, identity, magnitude, matrix, maxima, plain, require, sums
from ..kernel.motion import Plant
from ..kernel.verdict import Record, Rejected
from ..model.plants import plant_of
from .observer import OnBoard
from .rounding import UNIT, as_disturbance, command_error, row_maxima
from .selftest import calls_of, selftest
from .text import FARTHEST, PRECISIONS, PREFIX, Table, Tables, parsed, rounded

BESIDE = re.compile(
    r"\.polaris\.jsonl|(\w+)/(CMakeLists\.txt|\1\.[fhc]pp|fsw/(src/\1_app\.[ch]|tables/\1_tbl\.c))", re.ASCII
)
"""Other files that Polaris writes: its list, and glue. Any further one a compiler might read."""
CALLS = 100  # at least, of a self-test
MATRICES = 64  # roundings by which transitions may be off, relative to the largest entry of a row or to 1


def check_code(document: Document, folder: Path, record: Record) -> list[str]:
    """Compare the flight code in a folder with the certificate; return the assumptions trusted besides."""
    if document.guarantee != "proved":
        raise Rejected("code", f"the guarantee is {document.guarantee}, but must be proved to fly")
    prefix, tables, precision, digest = read_code(folder)
    if digest != document.digest:
        raise Rejected("code", f"the code is of another certificate, {digest}")
    plant = plant_of(document)
    _check_tables(document, plant, tables, precision)
    record.holds("code", f"{prefix}: text, tables and self-test in {precision} are the certificate's")
    assumed, statement = _check_rounding(document, plant, tables, precision)
    record.holds("rounding", statement)
    online = [
        "where the online monitor decides, claims of the goal, spending, drifts and aborts are not made"
    ]
    input_name = "measurement" if tables.seen else "estimate"
    first = ", its first estimate and the commands before the flight" if tables.seen else ""
    predicted = not tables.seen and (document.observer is not None or bool(document.timing.get("delay")))
    estimator = "what predicts the estimate is told S's commands as the exact law has them: what rounded ones"
    estimator += " change of it is bounded in code with the observer alone"
    return [
        f"the flight code is called once at the start of every control period, with the {input_name} that the"
        f" scenario declares{first}; its compiler and processor keep to C99 and IEEE 754",
        assumed,
        *(online if tables.rows else []),
        *([estimator] if predicted else []),
    ]


def precisions(document: Document) -> str:
    """Return how exact flight code of a certificate is in each precision; its tables are rounded once."""
    plant, n, m = plant_of(document), len(document.A), len(document.u_max)
    path = exact_path(document, plant, document.states[document.steps])
    parts = zip(*[(identity(n), arb_mat(n, m)), *plant.steps][: document.q], strict=True)
    transitions, gains = ([[list(map(float, row)) for row in M.tolist()] for M in part] for part in parts)
    tables, words = Tables(**_expected_tables(document), moved=transitions, pushed=gains), list[str]()
    for precision in PRECISIONS:
        error = command_error(document, tables.rounded(precision), precision, path)
        disturbance = as_disturbance(document, plant, error)
        words.append(f"{precision} within {float(error.upper()):.3g} N")
        if disturbance is not None and document.w_max > 0:
            share = float((disturbance / document.w_max).upper())
            words[-1] += f", {share:.3g} of the disturbance bound{', too much to fly' * (share >= 1)}"
    return f"commands of flight code, tables rounded once: {'; '.join(words)}"


def read_code(folder: Path) -> tuple[str, Tables, str, str]:
    """Return prefix, tables, precision and digest of the code in a folder.

    `Rejected` if it has another text than that of its numbers.
    """
    prefix, texts = _texts(folder)
    try:
        tables, precision, digest = parsed(texts[f"{prefix}.h"], texts[f"{prefix}.c"], prefix)
        program = texts[f"{prefix}_selftest.c"]
        calls = calls_of(program, prefix)
        if len(calls) < CALLS:
            raise ValueError(f"the self-test makes {len(calls)} calls, and must make at least {CALLS}")
        if program != selftest(tables, prefix, precision, calls):
            raise ValueError("the self-test expects other answers than those of the tables")
    except (ValueError, IndexError, KeyError, TypeError, OverflowError, ZeroDivisionError) as error:
        raise Rejected("code", f"{type(error).__name__}: {error}") from error
    return prefix, tables, precision, digest


def _texts(folder: Path) -> tuple[str, dict[str, str]]:
    """Return the prefix of the code in a folder, and the texts of its files."""
    files = (path for path in folder.rglob("*") if path.is_symlink() or not path.is_dir())
    names = sorted(path.relative_to(folder).as_posix() for path in files)
    prefix = next((name[:-2] for name in names if name.endswith(".h") and "/" not in name), "")
    needed = f"{prefix}.h", f"{prefix}.c", f"{prefix}_selftest.c"
    if not PREFIX.fullmatch(prefix) or not {*needed} <= {*names}:
        raise Rejected("code", f"the folder must hold a header, a source and a self-test, not {names}")
    if other := [name for name in names if name not in needed and not BESIDE.fullmatch(name)]:
        raise Rejected("code", f"the folder holds {other[0]!a}, which `polaris export c` does not write")
    try:
        return prefix, {name: contents(folder / name).decode("ascii") for name in needed}
    except UnicodeDecodeError as error:
        raise Rejected("code", f"is not ASCII: {error}") from error


def _check_rounding(document: Document, plant: Plant, tables: Tables, precision: str) -> tuple[str, str]:
    """Confirm the stated bound on errors of commands; return its assumptions on the world, and the bound.

    The error does what a disturbance does: the environment must leave as much of the declared bound.
    """
    path = exact_path(document, plant, document.states[document.steps])
    error, bound = command_error(document, tables, precision, path), arb(tables.rounding)
    if tables.seen:
        error = OnBoard(document, plant, tables, precision).command_error(error)
    require(
        "rounding", bound - error, f"commands may be {float(error):.4g} N off, {float(bound):.4g} is stated"
    )
    require("rounding", error * 2 - bound, f"{float(bound):.4g} N is stated, twice the bound or more")
    disturbance, statement = (
        as_disturbance(document, plant, bound),
        f"commands in {precision} are within {float(bound):.3g} N",
    )
    if disturbance is None or not document.w_max > 0:
        return f"{statement} of the exact ones: no disturbance bound covers that", statement
    share = float((disturbance / document.w_max).upper())
    require("rounding", document.w_max - disturbance, f"rounding takes {share:.3g} of the disturbance bound")
    statement += f" of the exact ones, {share:.3g} of the disturbance bound"
    assumption = f"the disturbance is at most 1 - {share:.3g} of its bound: rounding on board takes the rest"
    ranges = "states and measurements have been" if tables.seen else "states are"
    return f"{assumption}, while {ranges} within the range of the code", statement


def _check_tables(document: Document, plant: Plant, tables: Tables, precision: str) -> None:
    """Check that all numbers are the certificate's, rounded once; transitions are off by few roundings."""
    n, m, q = len(document.A), len(document.u_max), document.q
    sizes, true_sizes = tuple(tables.sizes.values())[:5], (n, m, q, document.steps, document.cells)
    if sizes != true_sizes:
        raise Rejected("code", f"the tables are for sizes {sizes}, not {true_sizes}")
    expected = _expected_tables(document)
    for name, value in expected.items():
        _equal(name, getattr(tables, name), value, precision)
    exact = [(identity(n), arb_mat(n, m)), *plant.steps][:q]
    _near("moved", tables.moved, [transition for transition, _ in exact], precision)
    _near("pushed", tables.pushed, [gain for _, gain in exact], precision)
    if tables.seen:
        on_board = OnBoard(document, plant, tables, precision)
        for name, matrices in on_board.exact().items():
            table = getattr(tables, name)
            _near(name, table if name in ("later", "updates") else [table], matrices, precision)
        _equal("heard", tables.heard, on_board.heard(expected["range"]), precision)


def _near(name: str, stored: Table, exact: list[arb_mat], precision: str) -> None:
    """Check that matrices are off by few roundings."""
    if [[len(row) for row in rows] for rows in stored] != [[M.ncols()] * M.nrows() for M in exact]:
        raise Rejected("code", f"{name} is not of the size of the certificate's")
    for node, (rows, M) in enumerate(zip(stored, exact, strict=True)):
        for i, (row, exact_row) in enumerate(zip(rows, M.tolist(), strict=True)):
            slack = MATRICES * UNIT[precision] * max(1.0, *map(abs, row))
            for x, y in zip(row, exact_row, strict=True):
                place = f"{name}, node {node}, row {i}"
                require("code", slack - abs(y - x), f"{place}: {x!r} is not {plain(y)}")


def check_plausible(flight: Continuation, sizes: list[arb_mat]) -> None:
    """Check that the code takes no state or measurement of a proven flight for an error, half of its limit.

    Errors are at most of those sizes (N, 1) where S takes over, at any time.
    """
    tightenings = flight.tracker.tightenings("states", identity(len(flight.document.A)))
    errors = column(
        sums(tightenings.tightening_at_any_time(row_maxima(sizes)), maxima(*tightenings.disturbed))
    )
    reference = row_maxima([node for arc in flight.path.arcs for node in arc.nodes])
    states, observer = reference + errors, flight.document.observer or {"measures": [], "noise": []}
    measured = magnitude(matrix(observer["measures"], states.nrows())) * states + column(observer["noise"])
    for i, size in enumerate((*states.entries(), *measured.entries())):
        text = f"number {i} may be as large as {plain(size)}, the code believes none beyond {FARTHEST:g}"
        require("code", FARTHEST / 2 - size, text)


def _expected_tables(document: Document) -> dict[str, Table]:
    """Return the tables that hold numbers of the certificate."""
    gain, cells = document.laws[0].gain, document.cells
    assert gain is not None  # as of every safety controller
    return {
        "covered": (document.steps if document.horizon == "none" else cells) * document.q,
        "modes": document.modes,
        "waypoints": document.states[:cells],
        "feed": document.inputs[: document.steps],
        "gain": gain,
        "limit": document.u_max,
        "range": _range(document, gain),
    }


def _equal(name: str, stored: Table, value: Table, precision: str) -> None:
    if isinstance(value, list):
        if not isinstance(stored, list) or len(stored) != len(value):
            raise Rejected("code", f"{name} is not of the size of the certificate's")
        for i, (one, other) in enumerate(zip(stored, value, strict=True)):
            _equal(f"{name}[{i}]", one, other, precision)
    elif stored != (value if isinstance(value, int) else rounded(value, precision)):
        raise Rejected("code", f"{name} is {stored!r}, the certificate's is {value!r}")


def _range(document: Document, gain: Table) -> list[float]:
    """Return the range of states for which rounding is bounded: the reference's, and errors about it."""
    ranges = []
    for j in range(len(document.A)):
        slopes = [(abs(row[j]), limit) for row, limit in zip(gain, document.u_max, strict=True)]
        error = min((2 * limit / slope for slope, limit in slopes if slope), default=FARTHEST)
        ranges.append(min(max(abs(state[j]) for state in document.states) + error, FARTHEST))
    return ranges
