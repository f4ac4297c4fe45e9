"""Traces are read in the forms they come in; malformed ones end with one message that names the place."""

import copy
import enum
import json

import numpy as np
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


# -- forms ------------------------------------------------------------------------------------------


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
        ([[0, 1, 2, 3]], "point", [1, 2, 3], None),
        ([[0, 5]], "point", [5], None),
        ([[0, [[1, 2, 3], 4]]], "ball", [1, 2, 3], [4]),
        ([[0, [1, 2, 3], 4]], "ball", [1, 2, 3], [4]),
        ([[0, 1, 2, 3, 4]], "ball", [1, 2, 3], [4]),
        ([[0, [[1, 2, 3], [4]]]], "ball", [1, 2, 3], [4]),
        ([[0, [5, 2]]], "ball", [5], [2]),
        ([[0, [[1, 2, 3], 4, 5, 6]]], "rectangle", [1, 2, 3], [4, 5, 6]),
        ([[0, [[1, 2, 3], [4, 5, 6]]]], "rectangle", [1, 2, 3], [4, 5, 6]),
        ([[0, [1, 2, 3], 4, 5, 6]], "rectangle", [1, 2, 3], [4, 5, 6]),
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


def test_moving_polytope_keeps_one_matrix_if_it_does_not_turn(tmp_path):
    turning = [[[0, 1, 0], *BOX[0][1:]], BOX[1]]
    rows = [[t, [BOX[0], [b + t for b in BOX[1]]]] for t in range(4)]
    assert read(tmp_path, trace(s=entry("polytope", *rows))).unsafe["s"].A.shape == (1, 6, 3)
    rows[2] = [2, turning]
    assert read(tmp_path, trace(s=entry("polytope", *rows))).unsafe["s"].A.shape == (4, 6, 3)


def test_objects_in_memory():
    rows = [(0.0, np.array([1.0, 2.0])), (1.0, np.array([3.0, 4.0]))]
    data = {
        "agents": {"a": {"state_trace": rows, "mode_trace": (Mode.UNTRUSTED, Mode.SAFETY)}},
        "unsafe": {"b": {"set_type": "ball", "state_trace": [(np.float64(0), (np.array([0, 0]), 2))]}},
    }
    parsed = parse_trace(data)
    assert parsed.agents["a"].states.tolist() == [[1, 2], [3, 4]]
    assert parsed.agents["a"].modes.tolist() == [2, 3]
    assert parsed.unsafe["b"].radii.tolist() == [2]


def test_what_is_not_known_is_passed_over_and_told(tmp_path):
    data = trace({"a": agent([[0, 0.0]], colour="red")}, b={**entry("point", [0, 1]), "mass": 3})
    parsed = read(tmp_path, data | {"version": 2})
    assert parsed.ignored == ("version", "agents.a.colour", "unsafe.b.mass")


def test_names_may_be_anything(tmp_path):
    parsed = read(tmp_path, trace({"": agent([[0, 0.0]]), "[red] ä.b": agent([[0, 0.0]])}))
    assert list(parsed.agents) == ["", "[red] ä.b"]


def test_byte_order_mark(tmp_path):
    path = tmp_path / "t.json"
    path.write_bytes(b"\xef\xbb\xbf" + json.dumps(trace()).encode())
    assert len(read_trace(path).agents["chaser"].times) == 5


# -- malformed --------------------------------------------------------------------------------------

ROWS = "agents.chaser.state_trace"
MODES = "agents.chaser.mode_trace"
SET = "unsafe.s.state_trace"


def changed(*keys, value):
    """A good trace with one part replaced; None of a key deletes."""

    def change(data):
        data = copy.deepcopy(data)
        at = data
        for key in keys[:-1]:
            at = at[key]
        at[keys[-1]] = value
        return data

    return change


def without(*keys):
    def change(data):
        data = copy.deepcopy(data)
        at = data
        for key in keys[:-1]:
            at = at[key]
        del at[keys[-1]]
        return data

    return change


def chaser(key, i, value):
    return changed("agents", "chaser", key, i, value=value)


def other_set(kind, *rows):
    return changed("unsafe", "s", value=entry(kind, *rows))


GOOD = trace(s=entry("ball", [0, [[0, 0, 0], 1]], [1, [[0, 0, 0], 1]], [2, [[0, 0, 0], 1]]))

MALFORMED = {
    "root is a list": (lambda data: [data], "trace"),
    "no agents": (without("agents"), "agents"),
    "no unsafe": (without("unsafe"), "unsafe"),
    "agents is a list": (changed("agents", value=[]), "agents"),
    "agents is empty": (changed("agents", value={}), "agents"),
    "agent is a list": (changed("agents", "chaser", value=[]), "agents.chaser"),
    "set is a number": (changed("unsafe", "s", value=3), "unsafe.s"),
    "no state_trace": (without("agents", "chaser", "state_trace"), ROWS),
    "state_trace is empty": (changed("agents", "chaser", "state_trace", value=[]), ROWS),
    "state_trace is an object": (changed("agents", "chaser", "state_trace", value={}), ROWS),
    "no mode_trace": (without("agents", "chaser", "mode_trace"), MODES),
    "row is a number": (chaser("state_trace", 3, 5.0), f"{ROWS}[3]"),
    "row has no state": (chaser("state_trace", 3, [3]), f"{ROWS}[3]"),
    "nested row has no state": (changed("agents", "chaser", value=agent([[0, []], [1, []]])), f"{ROWS}[0]"),
    "row is too short": (chaser("state_trace", 3, [3, 7, 0]), f"{ROWS}[3]"),
    "row is too long": (chaser("state_trace", 2, [2, 8, 0, 0, -1, 0, 0, 0]), f"{ROWS}[2]"),
    "row holds a text": (chaser("state_trace", 3, [3, "7", 0, 0, -1, 0, 0]), f"{ROWS}[3]"),
    "row holds null": (chaser("state_trace", 3, [3, None, 0, 0, -1, 0, 0]), f"{ROWS}[3]"),
    "row holds true": (chaser("state_trace", 1, [1, True, 0, 0, -1, 0, 0]), f"{ROWS}[1]"),
    "row holds a list": (chaser("state_trace", 1, [1, [9], 0, 0, -1, 0, 0]), f"{ROWS}[1]"),
    "row holds too large a number": (chaser("state_trace", 4, [4, 1e301, 0, 0, -1, 0, 0]), f"{ROWS}[4]"),
    "row holds too large a whole number": (
        chaser("state_trace", 4, [4, 10**400, 0, 0, 0, 0, 0]),
        f"{ROWS}[4]",
    ),
    "time is null": (chaser("state_trace", 0, [None, 10, 0, 0, -1, 0, 0]), f"{ROWS}[0]"),
    "time runs backwards": (chaser("state_trace", 3, [1.5, 7, 0, 0, -1, 0, 0]), f"{ROWS}[3]"),
    "too few modes": (changed("agents", "chaser", "mode_trace", value=[1, 2]), MODES),
    "too many modes": (changed("agents", "chaser", "mode_trace", value=[1] * 6), MODES),
    "modes are a text": (changed("agents", "chaser", "mode_trace", value="SAFETY"), MODES),
    "mode is a fraction": (chaser("mode_trace", 2, 1.5), f"{MODES}[2]"),
    "mode is true": (chaser("mode_trace", 2, True), f"{MODES}[2]"),
    "mode is an unheard name": (chaser("mode_trace", 2, "HAPPY"), f"{MODES}[2]"),
    "mode is an empty object": (chaser("mode_trace", 2, {}), f"{MODES}[2]"),
    "mode is a list": (chaser("mode_trace", 2, [2]), f"{MODES}[2]"),
    "mode is beyond 64 bits": (chaser("mode_trace", 2, 2**70), f"{MODES}[2]"),
    "running times are a number": (
        changed("agents", "chaser", "running_times", value=3),
        "agents.chaser.running_times",
    ),
    "running time is a text": (
        changed("agents", "chaser", "running_times", value=[0.1, "x"]),
        "agents.chaser.running_times[1]",
    ),
    "running time is negative": (
        changed("agents", "chaser", "running_times", value=[0.1, -0.1]),
        "agents.chaser.running_times[1]",
    ),
    "no set_type": (without("unsafe", "s", "set_type"), "unsafe.s.set_type"),
    "unheard set_type": (changed("unsafe", "s", "set_type", value="cone"), "unsafe.s.set_type"),
    "set_type is a list": (changed("unsafe", "s", "set_type", value=["ball"]), "unsafe.s.set_type"),
    "set without rows": (changed("unsafe", "s", "state_trace", value=[]), SET),
    "set row is null": (changed("unsafe", "s", "state_trace", 1, value=None), f"{SET}[1]"),
    "ball without radius": (other_set("ball", [0, [[0, 0, 0], 1]], [1, [1, 2, 3]]), f"{SET}[1]"),
    "ball with three radii": (other_set("ball", [0, [[0, 0, 0], [1, 1, 1]]]), f"{SET}[0]"),
    "ball of negative radius": (other_set("ball", [0, [[0, 0, 0], 1]], [1, [[0, 0, 0], -1]]), f"{SET}[1]"),
    "ball of four axes": (other_set("ball", [0, [[0, 0, 0, 0], 1]]), f"{SET}[0]"),
    "ball changes its axes": (other_set("ball", [0, [[0, 0, 0], 1]], [1, [[0, 0], 1]]), f"{SET}[1]"),
    "set runs backwards": (other_set("ball", [1, [[0, 0, 0], 1]], [0, [[0, 0, 0], 1]]), f"{SET}[1]"),
    "rectangle lacks a length": (other_set("rectangle", [0, [[0, 0, 0], 1, 1]]), f"{SET}[0]"),
    "rectangle of odd length": (other_set("rectangle", [0, 1, 2, 3]), f"{SET}[0]"),
    "rectangle of negative length": (other_set("rectangle", [0, [[0, 0], 1, -1]]), f"{SET}[0]"),
    "point is null": (other_set("point", [0, None]), f"{SET}[0]"),
    "point without axes": (other_set("point", [0, []]), f"{SET}[0]"),
    "polytope without b": (other_set("polytope", [0, [BOX[0]]]), f"{SET}[0]"),
    "polytope with too short a b": (other_set("polytope", [0, [BOX[0], [1, 1]]]), f"{SET}[0]"),
    "polytope of flat rows": (other_set("polytope", [0, [[1, 0, 0], [1, 1, 1]]]), f"{SET}[0]"),
    "polytope of ragged rows": (other_set("polytope", [0, [[[1, 0], [1]], [1, 1]]]), f"{SET}[0]"),
    "polytope without facets": (other_set("polytope", [0, [[], []]]), f"{SET}[0]"),
    "polytope of four axes": (other_set("polytope", [0, [[[1, 0, 0, 0]], [1]]]), f"{SET}[0]"),
    "polytope with a zero row": (
        other_set("polytope", [0, BOX], [1, [[[0, 0, 0], *BOX[0][1:]], BOX[1]]]),
        f"{SET}[1]",
    ),
    "polytope gains a facet": (
        other_set("polytope", [0, BOX], [1, [[*BOX[0], [1, 1, 0]], [*BOX[1], 1]]]),
        f"{SET}[1]",
    ),
    "polytope b holds a text": (other_set("polytope", [0, [BOX[0], ["1", 1, 1, 1, 1, 1]]]), f"{SET}[0]"),
}


@pytest.mark.parametrize("change, place", MALFORMED.values(), ids=MALFORMED)
def test_malformed_traces_name_the_place(tmp_path, change, place):
    assert read(tmp_path, GOOD).unsafe["s"].d == 3
    with pytest.raises(ScenarioError) as caught:
        read(tmp_path, change(GOOD))
    assert caught.value.field == place
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 500


TEXTS = {
    "empty": ("", "JSON"),
    "not JSON": ("state_trace: 3", "JSON"),
    "cut off": (json.dumps(GOOD)[:-20], "JSON"),
    "NaN": (json.dumps(GOOD).replace("-1.0", "NaN", 1), "NaN"),
    "Infinity": (json.dumps(GOOD).replace("-1.0", "Infinity", 1), "Infinity"),
    "-Infinity": (json.dumps(GOOD).replace("-1.0", "-Infinity", 1), "-Infinity"),
    "key twice": ('{"agents": {}, "agents": {}, "unsafe": {}}', "'agents' twice"),
    "too deep": ("[" * 200_000, "deep"),
    "digits without end": ('{"agents": ' + "1" * 10_000 + "}", "JSON"),
    "a pickle": ("\x80\x04K\x01.", "JSON"),
    "Python": ("__import__('os').system('true')", "JSON"),
}


@pytest.mark.parametrize("text, told", TEXTS.values(), ids=TEXTS)
def test_what_is_no_strict_json_is_refused(tmp_path, text, told):
    with pytest.raises(ScenarioError, match=told) as caught:
        read(tmp_path, text)
    assert str(tmp_path) in str(caught.value) or len(str(tmp_path)) > 100


def test_numbers_that_overflow_are_refused(tmp_path):
    with pytest.raises(ScenarioError, match=r"state_trace\[0\]"):
        read(tmp_path, json.dumps(GOOD).replace("-1.0", "1e999", 1))


def test_files_that_cannot_be_read(tmp_path):
    (tmp_path / "latin").write_bytes(b'{"agents": {"\xe4": 1}}')
    for path in (tmp_path / "none.json", tmp_path, tmp_path / "latin"):
        with pytest.raises(ScenarioError, match="trace"):
            read_trace(path)


def test_many_rows_are_read_in_linear_time(tmp_path):
    """20,000 rows of an agent and of a nested set; 1,000,000 take seconds."""
    rows = [[t / 10, 1.0, 2.0, 3.0] for t in range(20_000)]
    data = trace(
        {"a": agent(rows)}, s=entry("ball", *([t / 10, [[1.0, 2.0, 3.0], 1.0]] for t in range(20_000)))
    )
    parsed = read(tmp_path, data)
    assert parsed.agents["a"].states.shape == (20_000, 3)
    assert parsed.unsafe["s"].centers.shape == (20_000, 3)


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
