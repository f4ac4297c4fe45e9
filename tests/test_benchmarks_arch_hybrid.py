"""The quick ones of the public hybrid benchmarks: verdicts as expected, sound bounds."""

import pytest

from benchmarks.arch import gearbox, platoon, powertrain, rendezvous
from benchmarks.arch.row import Row


@pytest.mark.parametrize("name", ["SRNA01", "SRA01", "SRA04", "SRU01", "SRU02"])
def test_rendezvous(name):
    row = rendezvous.run(name)
    assert row.verdict == row.expected
    if row.bound is not None:
        tighter = row.bound <= row.known if name == "SRNA01" else row.bound >= row.known
        assert tighter
        assert row.reached <= row.bound if name == "SRNA01" else row.reached >= row.bound
    else:
        assert row.reached < rendezvous.SIDE


def test_platoon():
    for row in platoon.rows():
        assert row.verdict == row.expected == "proven"
        assert row.reached <= row.bound <= row.known


def test_gearbox():
    row = gearbox.run("GRBX01")
    assert row.verdict == "proven"
    assert 0.99 * row.bound <= row.reached <= row.bound < gearbox.IMPULSE


def test_powertrain():
    row = powertrain.run("DTN-theta1")
    assert row.verdict == "proven"
    assert row.reached <= row.bound <= 1.1 * row.reached


def test_a_row_knows_when_it_is_wrong():
    row = Row("x", "y", "proven", "violated", None, None, None, 0.0)
    assert not row.right
    assert Row("x", "y", "unknown", "violated", None, None, None, 0.0).right
