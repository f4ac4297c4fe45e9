"""Rows of today against the golden table, and the comparison against rows that are changed by hand."""

import pytest

from tests.golden import rows
from tests.golden.comparison import BETTER, OTHER, WORSE, compare
from tests.golden.scenes import ERRORS, SEEDS, SMALL, scenes
from tests.sizes import fewer

STORED = rows.read_table()
NAMES = [name for name in STORED if name not in SMALL]

PROVED = {"name": "scene", "scene": "a1b2", "exit_code": 0, "verdict": "VERIFIED", "modes": "UUSU"}
PROVED |= {"share": 0.75, "margin": 0.2, "start_margin": 0.6, "end": "one_period", "goal": "not_proven"}
PROVED |= {"goal_tolerance_m": 4.0, "goal_by_s": None, "goal_distance_m": 5.0, "tube": [1.0, 0.02]}
ARRIVED = PROVED | {"goal": True, "goal_by_s": 90.0, "goal_distance_m": 3.5}
REFUSED = {"name": "scene", "scene": "a1b2", "exit_code": 3}

WORSE_BY = {"verdict": "UNKNOWN", "share": 0.739, "margin": 0.19999, "start_margin": 0.5, "end": "none"}
WORSENED = [
    (PROVED, {key: value}) for key, value in (WORSE_BY | {"goal": False, "tube": [0.5, 0.03]}).items()
]
WORSENED += [(PROVED, REFUSED | {"exit_code": 4}), (REFUSED, {"exit_code": 2})]
WORSENED += [(ARRIVED, {"goal_by_s": 92.0, "goal_distance_m": 3.0}), (ARRIVED, {"goal_distance_m": 3.6})]


def kinds(stored, change):
    """Kinds of the differences between a row and a changed one."""
    return {each.kind for each in compare(stored, stored | change)}


@pytest.mark.parametrize(("stored", "change"), WORSENED)
def test_a_worse_row_is_a_fault(stored, change):
    assert WORSE in kinds(stored, change)
    assert not compare(PROVED, dict(PROVED)) and kinds(REFUSED, PROVED) == {BETTER}
    assert kinds(PROVED, {"share": 0.74, "modes": "UUSS"}) == {OTHER}
    less = {"margin": 0.1, "tube": [2.0, 0.02], "goal_distance_m": 6.0}  # passes where U flies more
    more = less | {"modes": "UUUU", "share": 1.0}
    assert kinds(PROVED, more) == {BETTER, OTHER} and kinds(PROVED, {"scene": "c3d4"}) == {OTHER}
    for loss in ({"verdict": "UNKNOWN"}, {"end": "none"}, {"goal": False}):
        assert WORSE in kinds(PROVED, more | loss)


def test_the_table_has_a_row_for_every_scene_and_most_are_proved():
    assert all(row["scene"] == scenes()[name].digest() for name, row in STORED.items())
    assert list(STORED) == list(scenes()) and set(SMALL) < set(STORED) and len(SEEDS) == 60
    assert {"static", "robot", "infeasible", "keep_out" + ERRORS} < set(STORED)
    proved = [row for row in STORED.values() if row["exit_code"] == 0]
    assert len(proved) >= 2 / 3 * len(STORED)
    assert all(row["verdict"] == "VERIFIED" for row in proved)
    assert sum(0 < row["share"] < 1 for row in proved) > 30


def judge(name):
    """Nothing that is stored of a scene is lost."""
    row, message = rows.make_row(scenes()[name])
    losses = [str(each) for each in compare(STORED[name], row) if each.kind == WORSE]
    assert not losses, "\n".join([*losses, message])


@pytest.mark.parametrize(
    "name", [*SMALL[:2], *(pytest.param(name, marks=pytest.mark.slow) for name in SMALL[2:])]
)
def test_the_cheapest_scenes_prove_what_they_proved(name):
    judge(name)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES[:: fewer(1, 8)])
def test_scenes_prove_what_they_proved(name):
    judge(name)
