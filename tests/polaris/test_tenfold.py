"""The benchmark of ten times each error: a row as the page has it."""

import json

import pytest

from benchmarks import tenfold


def test_rows_are_told_of_what_has_been_found():
    attack = {"runs": 600, "violated": False, "limits": [{"proven_share": 0.35}, {"proven_share": None}]}
    row = {"share": 0.5, "delta_v_m_s": 1.25, "goal": True}
    found = {
        "static, mass, 1": row,
        "static, mass, 10": row | {"share": 0.1, "outcome": "REJECTED", "attacks": attack},
        "static, delay, 10": row,
        "static, misalignment, 1": row,
        "static, misalignment, 10": {"reason": "the start", "exit_code": 3},
    }
    lines = tenfold.table(found, ("static",), list(tenfold.ERRORS), (1.0, 10.0)).splitlines()[2:]
    assert lines == [
        "| `static` | misalignment | 50.0 | none (3) | 1.25 | - | - |",
        "| `static` | mass | 50.0 | 10.0, REJECTED | 1.25 to 1.25 | 600: none violates | 35 to 35 % |",
    ]
    assert "thrusters.magnitude_error=0.49" in tenfold.settings("magnitude", 10.0)


def test_the_page_has_every_cell_and_each_is_confirmed():
    told = tenfold.TRADEOFFS.read_text(encoding="utf-8").split("<!-- table tenfold -->")[1]
    rows = [[cell.strip(" `") for cell in row.split("|")] for row in told.splitlines() if row[:3] == "| `"]
    assert [tuple(row[1:3]) for row in rows] == [(s, e) for s in tenfold.SCENES for e in tenfold.ERRORS]
    assert all(0 <= float(row[3]) <= 100 and row[5].endswith(": none violates") for row in rows)


@pytest.mark.slow
def test_ten_times_the_error_of_magnitude_leaves_more_than_half(tmp_path):
    asked = ["static", "--only", "magnitude", "--times", "10", "--attacks", "300"]
    tenfold.main([*asked, "--out", str(tmp_path)])
    found = json.loads((tmp_path / "tenfold.json").read_text())["static, magnitude, 10"]
    assert found["outcome"] == "VERIFIED" and not found["attacks"]["violated"] and found["share"] > 0.5
