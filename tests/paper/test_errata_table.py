"""The table of errata in docs/theory.md names tests that exist."""

import re
from pathlib import Path

HERE = Path(__file__).parent


def test_every_test_named_in_the_table_exists():
    table = (HERE.parents[1] / "docs" / "theory.md").read_text(encoding="utf-8")
    named = re.findall(r"`(test_\w+\.py)::(test_\w+)`", table)
    assert len(named) >= 10
    for file, test in named:
        assert f"def {test}(" in (HERE / file).read_text(encoding="utf-8"), f"{file}::{test}"
