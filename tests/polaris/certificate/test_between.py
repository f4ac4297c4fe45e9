"""Demands between what a run tells and what is derived: a told figure has a slack, a demand has none."""

from functools import partial
from unittest.mock import patch

import pytest

from polaris.certificate.checker import verify
from polaris.certificate.claims.arrival import Arrival
from polaris.certificate.claims.powered import BranchMotion
from polaris.certificate.claims.recovery import TOLD_SLACK
from tests.polaris.corruptions import hexed
from tests.polaris.forging import COARSE, Forger, Lie, make

ASKED = (
    *(COARSE, "schedule.bound_programs=0", "goal.tolerance_m=2.0", "tank.delta_v_m_s=1000.0"),
    *("schedule.delta_v_max_m_s=20.0", "thrusters.magnitude_error=0.02"),
    'abort={orbit={kind="stationary",state=[0.0,6.0,0.0,0.0],tolerance_m=0.5},within_s=10.0,delta_v_max_m_s=20.0}',
)
TOLD = 1 - 0.9 * TOLD_SLACK  # share of what is derived that a forged run tells
BETWEEN, BEYOND = 1 - 0.5 * TOLD_SLACK, 1 + 1e-6  # shares of it that a demand allows


@pytest.fixture(scope="module")
def forger(tmp_path_factory):
    folder = tmp_path_factory.mktemp("between")
    return Forger(make(ASKED, folder), folder)


@pytest.fixture(scope="module")
def derived(forger):
    """Figures that the checker derives of the honest run, by name; lists over steps for aborts."""
    known = {"before": [], "abort": [], "off": []}
    require_bound, affords, distance = Arrival.require_bound, BranchMotion.affords, BranchMotion.distance

    def told(self, what, claimed, value):
        known[what] = float(value.upper())
        require_bound(self, what, claimed, value)

    def spent(self, taken, budget, stated):
        known["before"].append(float(taken.before.upper()))
        known["abort"].append((taken.k, float(self.cost(taken, taken.step.cell).upper())))
        affords(self, taken, budget, stated)

    def off(self, taken, cell):
        away = distance(self, taken, cell)
        known["off"].append((taken.step.branch, float(away.upper())))
        return away

    with (
        patch.object(Arrival, "require_bound", told),
        patch.object(BranchMotion, "affords", spent),
        patch.object(BranchMotion, "distance", off),
    ):
        verdict = verify(forger.run)
    assert verdict.outcome == "VERIFIED", verdict.text()
    return known


def _distance(lie, known, share, given=False):
    """A tolerance that the scenario does not give is told, and proven as such."""
    value, goal = known["distance from the goal"], lie.schedule["guarantee"]["goal"]
    goal |= {"distance_m": TOLD * value, "tolerance_m": share * value}
    if given:
        lie.scenario["goal"]["tolerance_m"] = share * value


def _budget(lie, known, share):
    value = known["velocity change"]
    lie.schedule["guarantee"]["goal"]["delta_v_max_m_s"] = TOLD * value
    allowed = lie.schedule["rules"]["delta_v_max"] = share * value
    lie.scenario["schedule"]["delta_v_max_m_s"] = allowed


def _lasts(lie, known, share):
    upkeep = lie.schedule["guarantee"]["upkeep"]
    until, rate = known["velocity change until it is settled"], known["velocity change per second"]
    value = until + (upkeep["lasts_s"] - upkeep["settled_s"]) * rate
    upkeep |= {"until_settled_m_s": TOLD * until, "rate_m_s2": TOLD * rate, "tank_m_s": share * value}
    lie.scenario["tank"]["delta_v_m_s"] = share * value


def _tank(lie, known, share):
    value = max(sum(pair) for pair in zip(known["before"], (x for _, x in known["abort"]), strict=True))
    _tell_aborts(lie, known)
    lie.schedule["guarantee"]["upkeep"] |= {"tank_m_s": share * value, "lasts_s": 0.0}
    lie.scenario["tank"]["delta_v_m_s"] = share * value


def _abort(lie, known, share):
    value = share * max(x for _, x in known["abort"])
    _tell_aborts(lie, known)
    lie.certificate["powered"]["budget"] = hexed(value)
    lie.schedule["guarantee"]["powered_abort"]["delta_v_max_m_s"] = value
    lie.scenario["abort"]["delta_v_max_m_s"] = value


def _tell_aborts(lie, known):
    for k, value in known["abort"]:
        lie.schedule["guarantee"]["powered_abort"]["steps"][k]["delta_v_m_s"] = TOLD * value


def _orbit(lie, known, share):
    for place, branch in enumerate(lie.certificate["powered"]["branches"]):
        offs = [off for at, off in known["off"] if at == place]
        if offs:
            branch["tolerance"] = hexed(share * max(offs))


FORGED = {
    "the scenario's tolerance": (partial(_distance, given=True), "goal"),
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
            1 - 1.1 * TOLD_SLACK
        )
        lie.judge({"goal"})
