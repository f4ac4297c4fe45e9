"""Traces are read in the forms they come in; malformed ones end with one message that names the place."""

import copy
import enum
import json
import re

import pytest

from polaris.model.errors import ScenarioError
from polaris.model.scene.distances import UNKNOWN
from polaris.traces import parse_trace, read_trace
from tests.polaris.traces.traces import agent, entry, save, trace

BOX = [[[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], [1, 1, 1, 1, 1, 1]]


class Mode(enum.Enum):
    NORMAL = 1
    UNTRUSTED = 2
    SAFETY = 3


def read(tmp_path, data):
    return read_trace(save(tmp_path, data))


def test_flat_and_nested_rows_are_the_same(tmp_path):
    flat = read(tmp_path, trace({"a": agent([[0, 1, 2], [0.5, 3, 4]])}))
    nested = read(tmp_path, trace({"a": agent([[0, [1, 2]], [0.5, [3, 4]]])}))
    mixed = read(tmp_path, trace({"a": agent([[0, 1, 2], [0.5, [3, 4]]])}))
    assert flat.same_as(nested) and flat.same_as(mixed)
    assert flat.agents["a"].times.tolist() == [0, 0.5]
    assert flat.agents["a"].states.tolist() == [[1, 2], [3, 4]]


@pytest.mark.parametrize(
    "modes",
    [
        [1, 2, 3],
        [{"value": 1}, {"value": 2}, {"value": 3}],
        [{"name": "NORMAL"}, {"name": "UNTRUSTED"}, {"name": "SAFETY"}],
        ["NORMAL", "untrusted", "ControllerMode.SAFETY"],
        [1, {"value": 2, "name": "UNTRUSTED"}, "SAFETY"],
        list(Mode),
    ],
)
def test_modes_in_every_form(modes):
    parsed = parse_trace(trace({"a": agent([[t, 0.0] for t in range(3)], modes)}))
    assert parsed.agents["a"].modes.tolist() == [1, 2, 3]


@pytest.mark.parametrize("modes", [None, [None, None], ["UNKNOWN", None], [-1, None]])
def test_unknown_modes(tmp_path, modes):
    data = trace({"a": agent([[0, 0.0], [1, 0.0]])})
    data["agents"]["a"]["mode_trace"] = modes
    assert read(tmp_path, data).agents["a"].modes.tolist() == [UNKNOWN, UNKNOWN]


def test_other_numbers_stay_and_are_unknown(tmp_path):
    parsed = read(tmp_path, trace({"a": agent([[0, 0.0], [1, 0.0]], [7, 3])})).agents["a"]
    assert parsed.modes.tolist() == [7, 3]
    assert parsed.known_modes.tolist() == [UNKNOWN, 3]


@pytest.mark.parametrize(
    "rows, kind, centers, sizes",
    [
        ([[0, [1, 2, 3]]], "point", [1, 2, 3], None),
        ([[0, 5]], "point", [5], None),
        ([[0, [[1, 2, 3], 4]]], "ball", [1, 2, 3], [4]),
        ([[0, [1, 2, 3], 4]], "ball", [1, 2, 3], [4]),
        ([[0, 1, 2, 3, 4]], "ball", [1, 2, 3], [4]),
        ([[0, [5, 2]]], "ball", [5], [2]),
        ([[0, [[1, 2, 3], 4, 5, 6]]], "rectangle", [1, 2, 3], [4, 5, 6]),
        ([[0, [[1, 2, 3], [4, 5, 6]]]], "rectangle", [1, 2, 3], [4, 5, 6]),
        ([[0, 1, 2, 4, 5]], "rectangle", [1, 2], [4, 5]),
    ],
)
def test_definitions_bare_or_nested(tmp_path, rows, kind, centers, sizes):
    item = read(tmp_path, trace(s=entry(kind, *rows))).unsafe["s"]
    assert (item.set_type, item.d, item.centers.tolist()) == (kind, len(centers), [centers])
    if kind == "ball":
        assert item.radii.tolist() == sizes
    if kind == "rectangle":
        assert item.lengths.tolist() == [sizes]


@pytest.mark.parametrize("row", [[0, BOX], [0, *BOX], [0, [BOX[0], [[1]] * 6]]])
def test_polytopes_bare_or_nested(tmp_path, row):
    item = read(tmp_path, trace(s=entry("polytope", row))).unsafe["s"]
    assert item.A.tolist() == [BOX[0]] and item.b.tolist() == [BOX[1]]


def test_what_is_not_known_is_passed_over_and_told(tmp_path):
    data = trace({"a": agent([[0, 0.0]], colour="red")}, b={**entry("point", [0, 1]), "mass": 3})
    path = tmp_path / "t.json"
    path.write_bytes(b"\xef\xbb\xbf" + json.dumps(data | {"version": 2}).encode())  # a byte order mark
    parsed = read_trace(path)
    assert parsed.ignored == ("version", "agents.a.colour", "unsafe.b.mass")


ROWS, MODES, SPENT = (f"agents.chaser.{key}" for key in ("state_trace", "mode_trace", "running_times"))
SET = "unsafe.s.state_trace"
GOOD = trace(s=entry("ball", *([t, [[0, 0, 0], 1]] for t in range(3))))
GONE = object()


def put(at, value):
    """A good trace with the value at a dotted place replaced, or taken away."""
    data = copy.deepcopy(GOOD)
    *path, last = (int(key) if key.isdigit() else key for key in re.findall(r"\w+", at))
    holder = data
    for key in path:
        holder = holder[key]
    if value is GONE:
        del holder[last]
    else:
        holder[last] = value
    return data


def other(kind, *rows):
    return put("unsafe.s", entry(kind, *rows))


MALFORMED = [
    ([GOOD], "trace"),
    *((put(at, value), at) for at, value in (("agents", GONE), ("agents", []), ("agents", {}))),
    *((put(at, value), at) for at, value in (("unsafe", GONE), ("unsafe.s", 3), ("agents.chaser", []))),
    *((put(ROWS, value), ROWS) for value in (GONE, [], {})),
    *((put(f"{ROWS}[3]", value), f"{ROWS}[3]") for value in (5.0, [3], [3, 7, 0], [3, 1, 2, 3, 4, 5, 6, 7])),
    *(
        (put(f"{ROWS}[3]", [3, x, 0, 0, 0, 0, 0]), f"{ROWS}[3]")
        for x in ("7", None, True, [9], 1e301, 10**400)
    ),
    *((put(f"{ROWS}[3]", [t, 7, 0, 0, 0, 0, 0]), f"{ROWS}[3]") for t in (None, 1.5)),
    (put("agents.chaser", agent([[0, []], [1, []]])), f"{ROWS}[0]"),
    *((put(MODES, value), MODES) for value in (GONE, [1, 2], [1] * 6, "SAFETY")),
    *((put(f"{MODES}[2]", value), f"{MODES}[2]") for value in (1.5, True, "HAPPY", {}, [2], 2**70)),
    (put(SPENT, 3), SPENT),
    *((put(SPENT, [0.1, value]), f"{SPENT}[1]") for value in ("x", -0.1)),
    *((put("unsafe.s.set_type", value), "unsafe.s.set_type") for value in (GONE, "cone", ["ball"])),
    (put(SET, []), SET),
    (put(f"{SET}[1]", None), f"{SET}[1]"),
    *((put(f"{SET}[1]", [1, ball]), f"{SET}[1]") for ball in ([1, 2, 3], [[0, 0, 0], -1], [[0, 0], 1])),
    (put(f"{SET}[1]", [-1, [[0, 0, 0], 1]]), f"{SET}[1]"),
    *((other("ball", [0, ball]), f"{SET}[0]") for ball in ([[0, 0, 0], [1, 1, 1]], [[0, 0, 0, 0], 1])),
    *((other("rectangle", [0, box]), f"{SET}[0]") for box in ([[0, 0, 0], 1, 1], [[0, 0], 1, -1])),
    (other("rectangle", [0, 1, 2, 3]), f"{SET}[0]"),
    *((other("point", [0, value]), f"{SET}[0]") for value in (None, [])),
    *((other("polytope", [0, [BOX[0], *b]]), f"{SET}[0]") for b in ([], [[1, 1]], [["1", 1, 1, 1, 1, 1]])),
    *(
        (other("polytope", [0, [[1, 0, 0], [1, 1, 1]]]), f"{SET}[0]"),
        (other("polytope", [0, [[], []]]), f"{SET}[0]"),
    ),
    (other("polytope", [0, [[[1, 0], [1]], [1, 1]]]), f"{SET}[0]"),
    (other("polytope", [0, [[[1, 0, 0, 0]], [1]]]), f"{SET}[0]"),
    (other("polytope", [0, BOX], [1, [[[0, 0, 0], *BOX[0][1:]], BOX[1]]]), f"{SET}[1]"),
    (other("polytope", [0, BOX], [1, [[*BOX[0], [1, 1, 0]], [*BOX[1], 1]]]), f"{SET}[1]"),
]


@pytest.mark.parametrize("data, place", MALFORMED)
def test_malformed_traces_name_the_place(tmp_path, data, place):
    with pytest.raises(ScenarioError) as caught:
        read(tmp_path, data)
    assert caught.value.field == place
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 500


@pytest.mark.parametrize(
    "text, told",
    [
        ("", "JSON"),
        (json.dumps(GOOD)[:-20], "JSON"),
        (json.dumps(GOOD).replace("-1.0", "NaN", 1), "NaN"),
        (json.dumps(GOOD).replace("-1.0", "-Infinity", 1), "-Infinity"),
        (json.dumps(GOOD).replace("-1.0", "1e999", 1), r"state_trace\[0\]"),
        ('{"agents": {}, "agents": {}, "unsafe": {}}', "'agents' twice"),
        ("[" * 200_000, "deep"),
        ('{"agents": ' + "1" * 10_000 + "}", "JSON"),
        ("__import__('os').system('true')", "JSON"),
    ],
)
def test_what_is_no_strict_json_is_refused(tmp_path, text, told):
    assert read(tmp_path, GOOD).unsafe["s"].d == 3
    with pytest.raises(ScenarioError, match=told) as caught:
        read(tmp_path, text)
    assert str(tmp_path) in str(caught.value) or len(str(tmp_path)) > 100 or "state_trace" in told


def test_files_that_cannot_be_read(tmp_path):
    (tmp_path / "latin").write_bytes(b'{"agents": {"\xe4": 1}}')
    for path in (tmp_path / "none.json", tmp_path, tmp_path / "latin"):
        with pytest.raises(ScenarioError, match="trace"):
            read_trace(path)


def ball(velocities, kind="ball"):
    rows = [[0, [[1, 2, 3], 1]], [1, [[1, 2, 4], 1]]] if kind == "ball" else [[0, [1, 2, 3]], [1, [1, 2, 4]]]
    item = {"set_type": kind, "state_trace": rows, "velocity_trace": velocities}
    return {"agents": {"a": agent([[0, 0, 0, 0], [1, 0, 0, 0]])}, "unsafe": {"b": item}}


def test_velocities_of_a_ball(tmp_path):
    parsed = read(tmp_path, ball([[0, 0, 1], [0, 0, 2.5]]))
    assert parsed.unsafe["b"].velocities.tolist() == [[0, 0, 1], [0, 0, 2.5]] and not parsed.ignored
    assert read(tmp_path, ball(None)).unsafe["b"].velocities is None
    assert read(tmp_path, ball([[0, 0, 1]] * 2, "point")).ignored == ("unsafe.b.velocity_trace",)


@pytest.mark.parametrize(
    "given",
    [[], [[0, 0, 1]], 3, "no", [[0, 0], [0, 0]], [[0, 0, 1], [0, 0]], [[0, 0, 1], 2], [[0, 0, "1"]] * 2],
)
def test_malformed_velocities_are_refused(tmp_path, given):
    with pytest.raises(ScenarioError, match=r"^unsafe\.b\.velocity_trace"):
        read(tmp_path, ball(given))
