"""Choices that are exchanged or left out, and claims beyond what they give: all refused."""

import re
from itertools import islice

import pytest

pytest.importorskip("flint")

from tests.polaris.choices import changes, forged
from tests.polaris.forging import COARSE, Forger, make

ORBIT = '{kind="stationary",state=[0.0,6.0,0.0,0.0],tolerance_m=0.5}'
ASKED = (
    COARSE,
    f"abort={{orbit={ORBIT},within_s=10.0,delta_v_max_m_s=20.0,drift_s=6.0}}",
    "thrusters.magnitude_error=0.02",
    "schedule.bound_programs=0",
)
"""A scene with a profile of commands, branches of aborts and drifts, in which U's commands clip."""

PARTS = 8


@pytest.fixture(scope="module")
def forger(tmp_path_factory):
    folder = tmp_path_factory.mktemp("choices")
    return Forger(make(ASKED, folder), folder)


def test_the_honest_folder_is_verified(forger):
    assert forger.judge({}).outcome == "VERIFIED"


def test_there_are_more_than_a_hundred_of_them(forger):
    assert len({label for label, _ in changes(forger)}) > 100


@pytest.mark.parametrize("part", [None, *(pytest.param(i, marks=pytest.mark.slow) for i in range(PARTS))])
def test_forged_choices_and_bold_claims_are_refused(forger, part):
    """The quick test takes the first of each kind in half a part: numbers tell labels of a kind apart."""
    passed, chosen = [], list(islice(changes(forger), part or 0, None, 2 * PARTS if part is None else PARTS))
    if part is None:
        chosen = {re.sub(r"\d+", "", label): (label, change) for label, change in chosen[::-1]}.values()
        assert len(chosen) > 6
    for label, change in chosen:
        if (verdict := forger.judge(forged(forger, change))).outcome == "VERIFIED":
            passed.append(f"{label}: {verdict.text()}")
    assert not passed, "\n".join(passed)
