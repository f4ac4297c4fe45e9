"""Rows of today against the golden table, and the comparison against rows that are changed by hand."""

from dataclasses import replace

import pytest

from tests.golden import __main__ as command
from tests.golden import rows
from tests.golden.comparison import BETTER, OTHER, WORSE, compare
from tests.golden.scenes import ERRORS, SEEDS, SMALL, scenes
from tests.sizes import fewer

STORED = rows.read_table()
NAMES = [name for name in STORED if name not in SMALL]

PROVED = {
    "name": "scene",
    "scene": "a1b2",
    "exit_code": 0,
    "verdict": "VERIFIED",
    "modes": "UUSU",
    "share": 0.75,
    "margin": 0.2,
    "start_margin": 0.6,
    "end": "one_period",
    "goal": "not_proven",
    "goal_tolerance_m": 4.0,
    "goal_by_s": None,
    "goal_distance_m": 5.0,
    "tube": [1.0, 0.02],
}
ARRIVED = PROVED | {"goal": True, "goal_by_s": 90.0, "goal_distance_m": 3.5}
REFUSED = {"name": "scene", "scene": "a1b2", "exit_code": 3}

MORE = {"modes": "UUUU", "share": 1.0}

WORSENED = [
    (PROVED, REFUSED | {"exit_code": 4}),
    (REFUSED, {"exit_code": 2}),
    (REFUSED, {"exit_code": 1}),
    (PROVED, {"verdict": "REJECTED"}),
    (PROVED, {"verdict": "UNKNOWN"}),
    (PROVED | {"verdict": "UNKNOWN"}, {"verdict": "REJECTED"}),
    (PROVED, {"share": 0.739}),
    (PROVED, {"margin": 0.19999}),
    (PROVED, {"start_margin": 0.5}),
    (PROVED, {"end": "none"}),
    (PROVED, {"goal": False}),
    (ARRIVED, {"goal": "not_proven"}),
    (ARRIVED, {"goal_by_s": 92.0, "goal_distance_m": 3.0}),
    (ARRIVED, {"goal_tolerance_m": 4.1, "goal_by_s": 80.0}),
    (ARRIVED, {"goal_distance_m": 3.6}),
    (PROVED, {"goal_distance_m": 5.1}),
    (PROVED, {"tube": [1.0, 0.02 * (1 + 2e-9)]}),
    (PROVED, {"tube": [0.5, 0.03]}),
]

IMPROVED = [
    (REFUSED, PROVED),
    (REFUSED | {"exit_code": 2}, {"exit_code": 3}),
    (PROVED | {"verdict": "UNKNOWN"}, {"verdict": "VERIFIED"}),
    (PROVED, MORE),
    (PROVED, {"margin": 0.21}),
    (PROVED, {"start_margin": 0.7}),
    (PROVED, {"end": "infinite"}),
    (PROVED, {"goal": True, "goal_by_s": 120.0, "goal_distance_m": 3.9}),
    (ARRIVED, {"goal_by_s": 88.0, "goal_distance_m": 3.9}),
    (ARRIVED, {"goal_tolerance_m": 3.0, "goal_by_s": 99.0, "goal_distance_m": 2.9}),
    (ARRIVED, {"goal_distance_m": 3.0}),
    (PROVED, {"goal_distance_m": 4.5}),
    (PROVED, {"tube": [1.0, 0.01]}),
    (PROVED | {"modes": "SSSS", "share": 0.0, "margin": None, "tube": None}, PROVED),
]


def kinds(stored, change):
    """Kinds of the differences between a row and a changed one."""
    return {each.kind for each in compare(stored, stored | change)}


@pytest.mark.parametrize(("stored", "change"), WORSENED)
def test_a_worse_row_is_a_fault(stored, change):
    assert WORSE in kinds(stored, change)


@pytest.mark.parametrize(("stored", "change"), IMPROVED)
def test_a_better_row_passes(stored, change):
    seen = kinds(stored, change)
    assert BETTER in seen and WORSE not in seen


def test_what_rounding_does_and_a_point_of_the_share_pass():
    assert not compare(PROVED, dict(PROVED))
    assert not kinds(PROVED, {"tube": [1.0 + 5e-10, 0.02], "margin": 0.2 - 5e-10})
    assert kinds(PROVED, {"share": 0.74, "modes": "UUSS"}) == {OTHER}


def test_margins_may_shrink_only_where_u_flies_more():
    less = {"margin": 0.1, "tube": [2.0, 0.02], "goal_distance_m": 6.0}
    assert WORSE in kinds(PROVED, less) and WORSE in kinds(PROVED, {"modes": "USUU"} | less)
    assert kinds(PROVED, MORE | less) == {BETTER, OTHER}
    for lost in ({"verdict": "UNKNOWN"}, {"end": "none"}, {"goal": False}):
        assert WORSE in kinds(PROVED, MORE | less | lost)


def test_every_quantity_of_a_row_is_compared():
    noticed = {each.quantity for old, change in WORSENED for each in compare(old, old | change)}
    assert noticed - {"modes"} == set(PROVED) - {"name", "scene", "modes"}


def test_another_scene_is_told():
    assert kinds(PROVED, {"scene": "c3d4"}) == kinds(REFUSED, {"scene": "c3d4"}) == {OTHER}
    scene = scenes()["static"]
    assert scene.digest() == replace(scene, text=lambda: "# words\n" + scene.text()).digest()
    assert scene.digest() != replace(scene, text=lambda: scene.text().replace("0.2", "0.3")).digest()


@pytest.fixture
def told(monkeypatch, tmp_path, capsys):
    """Run the command on one scene, its row of today being the stored one with a change."""
    monkeypatch.setattr(rows, "TABLE", tmp_path / "table.json")
    rows.write_table({"static": PROVED | {"name": "static"}})

    def run(change, *options, message=""):
        made = PROVED | {"name": "static"} | change
        monkeypatch.setattr(command, "make_row", lambda scene: (made, message))
        code = command.main(["--only", "static", *options])
        return code, capsys.readouterr().out

    return run


def test_the_command_prints_each_difference_and_fails_for_a_fault(told):
    assert told({}) == (0, "static: exit code 0, VERIFIED (0.0 CPU-s)\n1 rows: 0 faults, 0 better\n")
    code, text = told({"margin": 0.1, "start_margin": 0.7})
    assert code == 1 and "worse  static: margin was 0.2, is 0.1" in text and "better static" in text
    code, text = told({"verdict": "REJECTED"}, message="tubes: too narrow")
    assert code == 1 and "exit code 0, REJECTED, tubes: too narrow (" in text
    code, text = told({"start_margin": 0.7})
    assert code == 0 and "1 rows: 0 faults, 1 better" in text


def test_the_command_writes_only_when_it_is_asked_to(told):
    told({"margin": 0.1})
    assert rows.read_table()["static"]["margin"] == 0.2
    assert told({"margin": 0.1}, "--write")[0] == 0
    assert rows.read_table()["static"]["margin"] == 0.1
    assert "0 rows" in told({}, "--missing")[1]
    rows.TABLE.unlink()
    code, text = told({})
    assert code == 1 and "--write" in text


def test_the_table_has_a_row_for_every_scene_and_most_are_proved():
    assert {name: row["scene"] for name, row in STORED.items()} == {
        n: s.digest() for n, s in scenes().items()
    }
    assert list(STORED) == list(scenes()) and set(SMALL) < set(STORED) and len(SEEDS) == 60
    assert {"static", "robot", "infeasible", "keep_out" + ERRORS} < set(STORED)
    proved = [row for row in STORED.values() if row["exit_code"] == 0]
    assert len(proved) >= 2 / 3 * len(STORED)
    assert all(row["verdict"] == "VERIFIED" for row in proved)
    assert sum(0 < row["share"] < 1 for row in proved) > 30


def judge(name):
    """Nothing that is stored of a scene is lost."""
    row, message = rows.make_row(scenes()[name])
    lost = [str(each) for each in compare(STORED[name], row) if each.kind == WORSE]
    assert not lost, "\n".join([*lost, message])


@pytest.mark.parametrize(
    "name", [*SMALL[:2], *(pytest.param(name, marks=pytest.mark.slow) for name in SMALL[2:])]
)
def test_the_cheapest_scenes_prove_what_they_proved(name):
    judge(name)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES[:: fewer(1, 5)])
def test_scenes_prove_what_they_proved(name):
    judge(name)
