"""Parts of a proof are about one system, one time grid and one reference, or are refused."""

from dataclasses import dataclass, fields, replace

import numpy as np
import pytest

from polaris.model.errors import ScenarioError
from polaris.model.scene.obstacles import BoxObstacle
from polaris.model.system import LinearSystem
from polaris.model.thrusters import Thrusters
from polaris.planning.reference import Reference
from polaris.scenario.scenario import load_scenario
from polaris.synthesis.controllers.controllers import AffineController, AnyThrust, TubeSegment, construct_s
from polaris.synthesis.safety.ball_sets import BallSets
from polaris.synthesis.safety.clearance import best_facets
from polaris.synthesis.safety.get_safety import get_recover, get_safety
from polaris.synthesis.schedule.rules import SwitchingRules
from polaris.synthesis.schedule.same_system import check_controller
from polaris.synthesis.schedule.synthesize import synthesize
from polaris.synthesis.tracker.feedback import Feedback
from polaris.synthesis.tracker.tracking import Tracking
from reach.sets.zonotope import Zonotope
from tests.polaris.conftest import small_controllers, small_problem, small_safety
from tests.polaris.tiny import synthesised

CHANGES = {
    "A": lambda M: 0.99 * M,
    "B": lambda M: 0.5 * M,
    "D": lambda M: 0.5 * M,
    "u_max": lambda u: u / 1000,
    "w_max": lambda w: 0.0,
    "C": lambda M: M[:2],
    "mass": lambda m: 2 * m,
    "mean_motion": lambda eta: None,
}


@dataclass(frozen=True)
class Own:
    """A controller of a class of its own, which says little of itself; it flies as another does."""

    law: object
    name: str = "own"

    def __getattr__(self, key):
        if key in ("propagate", "command", "system"):
            return getattr(self.law, key)
        raise AttributeError(key)


def other_system(key):
    system = small_safety().problem.system
    return replace(system, **{key: CHANGES[key](getattr(system, key))})


def proof(*laws, safety=None):
    return synthesize(None, safety or small_safety(), list(laws), SwitchingRules())


@pytest.mark.parametrize("key", CHANGES)
@pytest.mark.parametrize("kind", ["shared", "coasting", "clipped", "any", "own class", "reference", "safety"])
def test_nothing_over_another_system_is_taken(kind, key):
    safety, other = small_safety(), other_system(key)
    with pytest.raises(ScenarioError, match="must be") as caught:
        if kind == "safety":  # S itself
            law = replace(safety.controller, system=other)
            proof(small_controllers()["any"], safety=replace(safety, controller=law))
        elif kind == "reference":
            law = small_controllers()["coasting"]
            proof(replace(law, own=replace(law.own, system=other)))
        elif kind == "own class":
            proof(Own(replace(small_controllers()["any"], system=other)))
        else:
            proof(replace(small_controllers()[kind], system=other))
    assert f"system.{key}" in str(caught.value)


def test_a_controller_with_less_thrust_and_no_disturbance_buys_no_share():
    """The case that was found: the model of U must not be kinder than the problem."""
    safety = small_safety()
    kind = replace(safety.problem.system, u_max=[1e-4] * 3, w_max=0.0)
    with pytest.raises(ScenarioError, match=r"any\.system\.u_max: got \[0.0001, 0.0001, 0.0001\]"):
        proof(AnyThrust("any", kind, safety.reference, safety.tracking))


def test_an_equal_system_is_as_good_as_the_same():
    safety = small_safety()
    law = AnyThrust("any", replace(safety.problem.system), safety.reference, safety.tracking)
    assert proof(law).guarantee == "proved"
    assert proof(Own(law)).modes.tolist() == proof(law).modes.tolist()


def test_a_plain_system_counts_as_one_without_errors():
    safety, law = small_safety(), small_controllers()["coasting"]
    craft = safety.problem.system
    plain = LinearSystem(*(getattr(craft, part.name) for part in fields(LinearSystem)))
    again = replace(law, system=plain, own=replace(law.own, system=plain))
    assert proof(again).modes.tolist() == proof(law).modes.tolist()
    wrong = replace(craft, thrusters=Thrusters(along=0.1))
    with pytest.raises(ScenarioError, match=r"system\.thrusters\.along: got 0\.0; must be"):
        check_controller(again, replace(safety, problem=replace(safety.problem, system=wrong)))


def grids():
    law = small_controllers()["coasting"]
    own, tracking = law.own, law.tracking
    yield "period", replace(law, tracking=Tracking(law.system, tracking.gain, Feedback(3), 30.0))
    yield "tracking copied", replace(law, tracking=replace(tracking))
    yield "reference copied", replace(law, reference=replace(law.reference), own=law.reference)
    yield "too short", replace(law, own=Reference(own.system, 30.0, own.chi[:31], own.nu[:30]))
    yield "not finite", replace(law, own=replace(own, nu=np.full_like(own.nu, np.nan)))
    yield "inputs missing", replace(law, own=replace(own, chi=own.chi[:-1]))


@pytest.mark.parametrize("law", [pytest.param(law, id=name) for name, law in grids()])
def test_nothing_on_another_grid_or_reference_is_taken(law):
    with pytest.raises(ScenarioError, match="must"):
        proof(law)


def test_own_reference_on_other_steps_is_refused_where_it_is_made():
    law = small_controllers()["coasting"]
    with pytest.raises(ScenarioError, match="must have steps of 30 s"):
        replace(law, own=replace(law.own, delta=15.0))


def altered():
    safety, problem = small_safety(), small_problem()
    wider = Zonotope.box(problem.initial_set.c, [4, 4, 4, 0.01, 0.01, 0.01])
    debris = BoxObstacle("more", [0.0, 300.0, 0.0], [5.0] * 3)
    moved = BoxObstacle("debris", [125.0, 235.0, 0.0], [25.0] * 3)
    faster = small_safety(2.0)

    def asked(**changes):
        return replace(safety, problem=replace(problem, **changes))

    yield "steps", asked(K=50)
    yield "step", asked(delta=15.0)
    yield "period", asked(period=2.0)
    yield "other period", replace(faster, problem=replace(faster.problem, period=5.0))
    yield "initial set", asked(initial_set=wider)
    yield "one more", asked(unsafe=(*problem.unsafe, debris))
    yield "moved", asked(unsafe=(moved,))
    yield "system", asked(system=replace(problem.system, w_max=1e-4))
    yield "S clips", replace(safety, controller=replace(safety.controller, clips=True))
    yield "another gain", replace(safety, controller=replace(safety.controller, gain=problem.gains[0]))
    yield "S is any", replace(safety, controller=small_controllers()["any"])
    yield "another reference", replace(safety, reference=faster.reference)
    yield "another start", replace(safety, start=safety.start - safety.start.c + np.eye(6)[0])
    yield "smaller start", replace(safety, start=Zonotope.point(safety.start.c))
    sets = get_recover("polytope", faster.clearance, faster.bounds)
    yield "sets of another", replace(safety, recoverable=sets)
    end = safety.end
    yield (
        "end moved",
        replace(safety, end=replace(end, until=end.until + 1 if np.isfinite(end.until) else 1e9)),
    )
    yield "end for ever", replace(safety, end=replace(end, horizon=_other(end.horizon)))
    bounds = replace(safety.bounds, gamma_position=safety.bounds.gamma_position / 50)
    yield ("kinder bounds", replace(safety, bounds=bounds, recoverable=BallSets(safety.clearance, bounds)))
    chi, nu, K = safety.reference.chi, safety.reference.nu, problem.K
    shift = np.zeros_like(chi)
    shift[5:, 1] = 0.01
    yield "a jump", assembled(safety, replace(safety.reference, chi=chi + shift))
    yield "other inputs", assembled(safety, replace(safety.reference, nu=0.999 * nu))
    yield "no tail", assembled(safety, replace(safety.reference, chi=chi[: K + 1], nu=nu[:K]))
    still = Reference.propagate(problem.system, problem.delta, chi[0], np.zeros_like(nu))
    yield "through the obstacle", assembled(safety, still)
    ahead = np.zeros_like(nu)
    ahead[:3] = -2 * problem.system.u_max
    fast = Reference.propagate(problem.system, problem.delta, chi[0], ahead)
    yield "more thrust than there is", assembled(safety, fast)


def _other(horizon):
    return "one_period" if horizon == "infinite" else "infinite"


def assembled(safety, reference):
    """All parts of a Safety about another reference, but the margin at the start and the end as they were."""
    facets = best_facets(safety.tracking, reference, safety.clearance.unsafe, safety.start)
    clearance = replace(safety.clearance, reference=reference, facets=facets)
    return replace(
        safety,
        reference=reference,
        clearance=clearance,
        controller=construct_s(safety.tracking, reference),
        recoverable=get_recover("polytope", clearance, safety.bounds),
    )


@pytest.mark.parametrize("safety", [pytest.param(safety, id=name) for name, safety in altered()])
def test_a_safety_changed_afterwards_is_refused(safety):
    with pytest.raises(ScenarioError, match="must (be|move|contain)"):
        proof(safety=safety)


def test_a_safety_assembled_from_its_own_parts_is_taken():
    safety = small_safety()
    again = assembled(safety, replace(safety.reference))
    assert synthesize(again, experimental=[], rules=SwitchingRules()).guarantee == "proved"
    balls = replace(safety, recoverable=get_recover("ball", safety.clearance, safety.bounds))
    assert proof(small_controllers()["coasting"], safety=balls).guarantee == "proved"


def test_safety_of_another_scenario_is_refused_and_that_of_the_same_is_not():
    scenario, schedule = synthesised()
    again = synthesize(scenario, schedule.safety)
    assert again.modes.tolist() == schedule.modes.tolist()
    relaxed = scenario.with_assignments(["schedule.min_dwell_steps=2"])
    assert synthesize(relaxed, schedule.safety).guarantee == "proved"
    with pytest.raises(ScenarioError, match="must be"):
        synthesize(load_scenario("static"), schedule.safety)
    with pytest.raises(ScenarioError, match="must be"):
        synthesize(schedule.safety.problem, get_safety(small_problem()))


class Tube:
    """A law of a class of its own whose tube is tampered with."""

    name = "tube"

    def __init__(self, change):
        self.change, self.law = change, small_controllers()["coasting"]

    def propagate(self, start, k):
        return self.change(self.law.propagate(start, k))

    def command(self, *given):
        return self.law.command(*given)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda f: None, "must return"),
        (lambda f: replace(f, states=f.states[:-1]), "states"),
        (lambda f: replace(f, intersample=f.intersample[:, :3]), "intersample"),
        (lambda f: replace(f, intersample=-f.intersample), "must not be negative"),
        (lambda f: replace(f, intersample=np.nan * f.intersample), "must not be negative"),
        (lambda f: replace(f, end=Zonotope.point(np.zeros(3))), "end"),
        (lambda f: replace(f, end=Zonotope.point(f.end.c)), "must contain its last node"),
        (lambda f: replace(f, states=0.5 * np.eye(6) @ f.states), "must contain the set it starts from"),
    ],
)
def test_a_tube_that_is_none_is_refused(change, told):
    with pytest.raises(ScenarioError, match=told):
        proof(Tube(change))


def test_an_honest_tube_of_a_class_of_its_own_is_taken():
    assert proof(Tube(lambda f: f)).modes.tolist() == proof(small_controllers()["coasting"]).modes.tolist()
    assert isinstance(Tube(lambda f: f).propagate(small_safety().start, 0), TubeSegment)
    assert isinstance(small_safety().controller, AffineController)
