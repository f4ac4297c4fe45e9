"""The benchmark of ten times each error, and of all at once: rows as the page has them."""

import json
import re

import pytest

from benchmarks import tenfold
from tests.test_docs import assert_shown


def test_rows_are_told_of_what_has_been_found():
    attack = {"runs": 600, "violated": False, "limits": [{"proven_share": 0.35}, {"proven_share": None}]}
    row = {"share": 0.5, "delta_v_m_s": 1.25, "goal": True}
    results = {
        "static, mass, 1": row,
        "static, mass, 10": row | {"share": 0.1, "outcome": "REJECTED", "attacks": attack},
        "static, delay, 10": row,
        "static, misalignment, 1": row,
        "static, misalignment, 10": {"reason": "the start", "exit_code": 3},
    }
    head, _, *lines = tenfold.table(results, 10.0).splitlines()
    assert head == "| Error | `static` | `dynamic` | `keep_out` | `hold_point` |"
    assert [line for line in lines if not line.endswith("| - | - | - | - |")] == [
        "| delay | 50.0 (1.25) | - | - | - |",
        "| misalignment | none (3) | - | - | - |",
        "| mass | 10.0, REJECTED (1.25) | - | - | - |",
    ]
    broken = results["static, mass, 10"] | {"attacks": attack | {"violated": True}}
    assert tenfold.cell(broken) == "10.0, REJECTED, VIOLATED"
    asked = row | {"drift": "0 of 60", "aborts": "12 of 60", "lasts_h": 1.25, "outcome": "VERIFIED"}
    results |= {"static, none": row, "static, all, faults, aborts": asked}
    assert tenfold.together(results, ["static"]).splitlines()[2:] == [
        "| `static` | none | 50.0 | 1.25 | - | - | - | - |",
        "| `static` | all, faults, aborts | 50.0 | 1.25 | 0 of 60 | 12 of 60 | 1.2 | VERIFIED |",
    ]
    assert "thrusters.magnitude_error=0.49" in tenfold.settings("magnitude", 10.0)


def test_new_rows_replace_their_own_and_other_columns_the_whole_table():
    page = "a\n<!-- table t -->\n\n| S | E | x |\n|-|\n| s | e | 1 |\n| s | f | 2 |\n\n<!-- end -->\nb"
    more = tenfold.renew(page, "t", "| S | E | x |\n|-|\n| s | f | 3 |\n| r | e | 4 |")
    assert more == page.replace("| s | f | 2 |", "| s | f | 3 |\n| r | e | 4 |")
    other = tenfold.renew(page, "t", "| S | E | y |\n|-|\n| s | f | 3 |")
    assert other == page.replace("x |\n|-|\n| s | e | 1 |\n| s | f | 2 |", "y |\n|-|\n| s | f | 3 |")


def test_the_page_has_every_cell_and_each_is_confirmed():
    table = (
        tenfold.COSTS.read_text(encoding="utf-8").split("<!-- table tenfold -->")[1].split("<!-- end -->")[0]
    )
    head, _, *rows = (line.strip("| ").split(" | ") for line in table.strip().splitlines())
    assert head == ["Error", *(f"`{scene}`" for scene in tenfold.SCENES)]
    assert [row[0] for row in rows] == list(tenfold.ERRORS)
    cells = [re.fullmatch(r"(\d+\.\d) \(\d+\.\d\d\)", one) for row in rows for one in row[1:]]
    assert len(cells) == len(rows) * len(tenfold.SCENES)
    assert all(one is not None and 0 <= float(one[1]) <= 100 for one in cells)


@pytest.mark.slow
def test_ten_times_the_error_of_magnitude_leaves_more_than_half(tmp_path):
    asked = ["static", "--only", "magnitude", "--times", "10", "--attacks", "300"]
    tenfold.main([*asked, "--out", str(tmp_path)])
    result = json.loads((tmp_path / "tenfold.json").read_text())["static, magnitude, 10"]
    assert result["outcome"] == "VERIFIED" and not result["attacks"]["violated"] and result["share"] > 0.5


@pytest.mark.slow
@pytest.mark.parametrize("scene", tenfold.SCENES)
def test_bundled_scenes_are_worth_flying_with_every_error_at_once(scene, tmp_path):
    """At most ten points of U less than without errors, at most half as much velocity change more."""
    tenfold.main([scene, "--together", "--attacks", "0", "--out", str(tmp_path)])
    results = json.loads((tmp_path / "tenfold.json").read_text())
    ideal, real, asked = (results[f"{scene}, {kind}"] for kind in tenfold.TOGETHER)
    assert real["share"] >= ideal["share"] - 0.1 - 1e-9
    assert real["delta_v_m_s"] <= 1.5 * ideal["delta_v_m_s"]
    assert ideal["goal"] is real["goal"] is asked["goal"] is True
    assert not any(one["collided"] for one in (ideal, real, asked))
    assert {one["outcome"] for one in (ideal, real, asked)} == {"VERIFIED"}
    page = tenfold.COSTS.read_text(encoding="utf-8").split("<!-- table together -->")[1]
    shown = [line for line in page.split("<!-- end -->")[0].splitlines() if f"`{scene}`" in line]
    assert_shown("\n".join(shown), tenfold.together(results, [scene]), scene, numbers=True)
