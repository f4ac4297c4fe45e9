"""The table of errata in docs/theory.md names tests that exist."""

import re
from pathlib import Path

HERE = Path(__file__).parent


def test_every_test_named_in_the_table_exists():
    table = (HERE.parents[1] / "docs" / "theory.md").read_text(encoding="utf-8")
    named = re.findall(r"::(test_\w+)`", table)
    there = {
        name for file in HERE.glob("test_*.py") for name in re.findall(r"def (test_\w+)\(", file.read_text())
    }
    assert len(named) >= 13
    assert set(named) <= there
