"""The benchmark of ten times each error, and of all at once: rows as the page has them."""

import json
import re

import pytest

from benchmarks import tenfold
from tests.sizes import fewer
from tests.test_docs import assert_shown


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
    arguments = ["static", "--only", "magnitude", "--times", "10", "--attacks", "300"]
    tenfold.main([*arguments, "--out", str(tmp_path)])
    result = json.loads((tmp_path / "tenfold.json").read_text())["static, magnitude, 10"]
    assert result["outcome"] == "VERIFIED" and not result["attacks"]["violated"] and result["share"] > 0.5


@pytest.mark.slow
@pytest.mark.parametrize("scene", fewer(tenfold.SCENES, ["static", "dynamic"]))
def test_bundled_scenes_are_worth_flying_with_every_error_at_once(scene, tmp_path):
    """At most ten points of U less than without errors, at most half as much velocity change more."""
    tenfold.main([scene, "--together", "--attacks", "0", "--out", str(tmp_path)])
    results = json.loads((tmp_path / "tenfold.json").read_text())
    ideal, real, with_faults = (results[f"{scene}, {kind}"] for kind in tenfold.TOGETHER)
    assert real["share"] >= ideal["share"] - 0.1 - 1e-9
    assert real["delta_v_m_s"] <= 1.5 * ideal["delta_v_m_s"]
    assert ideal["goal"] is real["goal"] is with_faults["goal"] is True
    assert not any(one["collided"] for one in (ideal, real, with_faults))
    assert {one["outcome"] for one in (ideal, real, with_faults)} == {"VERIFIED"}
    page = tenfold.COSTS.read_text(encoding="utf-8").split("<!-- table together -->")[1]
    rows = [line for line in page.split("<!-- end -->")[0].splitlines() if f"`{scene}`" in line]
    assert_shown("\n".join(rows), tenfold.together(results, [scene]), scene, numbers=True)
