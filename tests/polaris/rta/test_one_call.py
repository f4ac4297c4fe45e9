"""The one call of run-time filters, for craft of any number of states and inputs."""

import numpy as np
import pytest

from polaris.rta.one_call import CallByCall, Decision, RawDecision
from reach.numerics.linear import discretize

LIMIT = np.array([0.4, 0.1])


class Robots:
    """Two point masses in the plane, each input with a limit of its own."""

    deputies, thrust_max = 2, LIMIT

    def discretize(self, duration):
        zero, eye = np.zeros((2, 2)), np.eye(2)
        return discretize(np.block([[zero, eye], [zero, zero]]), np.vstack([zero, eye]), duration)


class Pass(CallByCall):
    """The desired input where there is one, else the backup's."""

    def __init__(self, backup):
        super().__init__(Robots(), 1.0)
        self.backup = backup

    def _answer(self, call):
        notes, self.got = [], call
        backup = self._backed_up(self.backup, call, notes)
        u = np.where(call.given[:, None], call.u, backup)
        return RawDecision(u, ~call.given | call.clipped, ~call.given, np.zeros(2, dtype=bool), {}, notes)


def test_any_craft_is_filtered():
    one, x = Pass(lambda t, x: -x[:, 2:]), np.arange(8.0).reshape(2, 4)
    first = one.filter(0.0, x, [[1.0, 0.05], [np.nan, 0.0]])
    assert isinstance(first, Decision) and first.status == "backup"
    assert first.u.tolist() == [[0.4, 0.05], [-0.4, -0.1]]
    assert first.on_backup.tolist() == [False, True] and "missing or not finite: deputy 1" in first.fallback
    malformed = one.filter(0.5, x[:, :3], np.zeros((2, 2)))
    Phi, Gamma = Robots().discretize(0.5)
    np.testing.assert_allclose(one.got.x, x @ Phi.T + first.u @ Gamma.T)  # moved on with what was answered
    assert "the states are malformed" in malformed.fallback and malformed.status == "desired"


@pytest.mark.parametrize(
    ("backup", "told"),
    [
        (lambda t, x: 1 / 0, "raised ZeroDivisionError"),
        (lambda t, x: np.zeros(2), "of shape (2,)"),
        (lambda t, x: "full thrust", "malformed: str"),
        (lambda t, x: [[np.nan, 1.0], [0.0, np.inf]], "not finite"),
        (None, None),
    ],
)
def test_a_backup_that_fails_gives_what_can_be_used(backup, told):
    answer = Pass(backup).filter(0.0, np.zeros((2, 4)), None)
    assert np.isfinite(answer.u).all() and (np.abs(answer.u) <= LIMIT).all()
    assert told is None or "the backup controller failed: " in answer.fallback and told in answer.fallback
    assert answer.u[0, 1] == (0.1 if told == "not finite" else 0.0)
