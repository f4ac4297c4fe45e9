"""Demands between what a run tells and what is derived: a told figure has a slack, a demand has none."""

from functools import partial
from unittest.mock import patch

import pytest

from polaris.certificate.checker import verify
from polaris.certificate.claims.arrival import Arrival
from polaris.certificate.claims.powered import BranchMotion
from polaris.certificate.claims.recovery import CLAIM_SLACK
from tests.polaris.corruptions import hexed
from tests.polaris.forging import COARSE, Forger, Lie, make

ASKED = (
    *(COARSE, "schedule.bound_programs=0", "goal.tolerance_m=2.0", "tank.delta_v_m_s=1000.0"),
    *("schedule.delta_v_max_m_s=20.0", "thrusters.magnitude_error=0.02"),
    'abort={orbit={kind="stationary",state=[0.0,6.0,0.0,0.0],tolerance_m=0.5},within_s=10.0,delta_v_max_m_s=20.0}',
)
CLAIMED = 1 - 0.9 * CLAIM_SLACK  # share of the derived value that a forged run claims
BETWEEN, BEYOND = 1 - 0.5 * CLAIM_SLACK, 1 + 1e-6  # shares of it that a demand allows


@pytest.fixture(scope="module")
def forger(tmp_path_factory):
    folder = tmp_path_factory.mktemp("between")
    return Forger(make(ASKED, folder), folder)


@pytest.fixture(scope="module")
def derived(forger):
    """Figures that the checker derives of the honest run, by name; lists over steps for aborts."""
    figures = {"before": [], "abort": [], "off": []}
    require_bound, affords, distance = Arrival.require_bound, BranchMotion.affords, BranchMotion.distance

    def told(self, quantity, claimed, value):
        figures[quantity] = float(value.upper())
        require_bound(self, quantity, claimed, value)

    def spent(self, takeover, budget, claims):
        figures["before"].append(float(takeover.before.upper()))
        figures["abort"].append((takeover.k, float(self.cost(takeover, takeover.step.cell).upper())))
        affords(self, takeover, budget, claims)

    def off(self, takeover, cell):
        deviation = distance(self, takeover, cell)
        figures["off"].append((takeover.step.branch, float(deviation.upper())))
        return deviation

    with (
        patch.object(Arrival, "require_bound", told),
        patch.object(BranchMotion, "affords", spent),
        patch.object(BranchMotion, "distance", off),
    ):
        verdict = verify(forger.run)
    assert verdict.outcome == "VERIFIED", verdict.text()
    return figures


def _distance(lie, figures, share, declared=False):
    """A tolerance that the scenario does not give is told, and proven as such."""
    value, goal = figures["distance from the goal"], lie.schedule["guarantee"]["goal"]
    goal |= {"distance_m": CLAIMED * value, "tolerance_m": share * value}
    if declared:
        lie.scenario["goal"]["tolerance_m"] = share * value


def _budget(lie, figures, share):
    value = figures["velocity change"]
    lie.schedule["guarantee"]["goal"]["delta_v_max_m_s"] = CLAIMED * value
    allowed = lie.schedule["rules"]["delta_v_max"] = share * value
    lie.scenario["schedule"]["delta_v_max_m_s"] = allowed


def _lasts(lie, figures, share):
    upkeep = lie.schedule["guarantee"]["upkeep"]
    until, rate = figures["velocity change until it is settled"], figures["velocity change per second"]
    value = until + (upkeep["lasts_s"] - upkeep["settled_s"]) * rate
    upkeep |= {"until_settled_m_s": CLAIMED * until, "rate_m_s2": CLAIMED * rate, "tank_m_s": share * value}
    lie.scenario["tank"]["delta_v_m_s"] = share * value


def _tank(lie, figures, share):
    value = max(sum(pair) for pair in zip(figures["before"], (x for _, x in figures["abort"]), strict=True))
    _tell_aborts(lie, figures)
    lie.schedule["guarantee"]["upkeep"] |= {"tank_m_s": share * value, "lasts_s": 0.0}
    lie.scenario["tank"]["delta_v_m_s"] = share * value


def _abort(lie, figures, share):
    value = share * max(x for _, x in figures["abort"])
    _tell_aborts(lie, figures)
    lie.certificate["powered"]["budget"] = hexed(value)
    lie.schedule["guarantee"]["powered_abort"]["delta_v_max_m_s"] = value
    lie.scenario["abort"]["delta_v_max_m_s"] = value


def _tell_aborts(lie, figures):
    for k, value in figures["abort"]:
        lie.schedule["guarantee"]["powered_abort"]["steps"][k]["delta_v_m_s"] = CLAIMED * value


def _orbit(lie, figures, share):
    for place, branch in enumerate(lie.certificate["powered"]["branches"]):
        offs = [deviation for at, deviation in figures["off"] if at == place]
        if offs:
            branch["tolerance"] = hexed(share * max(offs))


FORGED = {
    "the scenario's tolerance": (partial(_distance, declared=True), "goal"),
    "a told tolerance": (_distance, "goal"),
    "the budget": (_budget, "schedule"),
    "the tank in the end": (_lasts, "upkeep"),
    "the tank in an abort": (_tank, "powered_abort"),
    "the budget of an abort": (_abort, "powered_abort"),
    "the tolerance of an orbit": (_orbit, "powered_abort"),
}


SLOW = [name for name in FORGED if name not in ("the scenario's tolerance", "the tolerance of an orbit")]


@pytest.mark.parametrize("name", FORGED)
def test_no_demand_between_what_is_told_and_what_is_derived_is_kept(forger, derived, name):
    lie, (change, claim) = Lie(forger), FORGED[name]
    change(lie, derived, BETWEEN)
    lie.summary["guarantee"] = lie.schedule["guarantee"]
    lie.judge({claim})


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW)) for name in FORGED]
)
def test_a_demand_beyond_what_is_derived_is_kept_if_figures_have_their_slack(forger, derived, name):
    lie = Lie(forger)
    FORGED[name][0](lie, derived, BEYOND)
    lie.summary["guarantee"] = lie.schedule["guarantee"]
    assert lie.verdict().outcome == "VERIFIED", lie.verdict().text()
    if name == "the scenario's tolerance":
        lie.schedule["guarantee"]["goal"]["distance_m"] = derived["distance from the goal"] * (
            1 - 1.1 * CLAIM_SLACK
        )
        lie.judge({"goal"})
