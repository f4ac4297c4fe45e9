"""Deliberate defects can be written into today's tree, and the tests that must notice them are there."""

from pathlib import Path

import pytest

from benchmarks.mutations import defects

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.parametrize("defect", defects(), ids=lambda each: each.old[:40])
def test_a_defect_has_one_place_and_a_test(defect):
    assert (ROOT / "polaris" / defect.file).read_text(encoding="utf-8").count(defect.old) == 1
    file, name = defect.test.split("[")[0].split("::")
    assert f"\ndef {name}(" in (ROOT / "tests" / "polaris" / file).read_text(encoding="utf-8")
