"""Parts of a proof are about one system, one time grid and one reference, or are refused."""

from dataclasses import fields, replace

import numpy as np
import pytest

from polaris import BoxObstacle, Feedback, LinearSystem, Reference, ScenarioError, Tracking, synthesize
from polaris.model.thrusters import Thrusters
from polaris.scenario.scenario import load_scenario
from polaris.synthesis.controllers.controllers import AnyThrust, construct_s
from polaris.synthesis.safety.ball_sets import BallSets
from polaris.synthesis.safety.clearance import best_facets
from polaris.synthesis.safety.get_safety import get_recover, get_safety
from polaris.synthesis.schedule.rules import SwitchingRules
from polaris.synthesis.schedule.same_system import check_controller
from reach import Zonotope
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


def other_system(key):
    system = small_safety().problem.system
    return replace(system, **{key: CHANGES[key](getattr(system, key))})


def proof(*laws, safety=None):
    return synthesize(None, safety or small_safety(), list(laws), SwitchingRules())


@pytest.mark.parametrize("key", CHANGES)
@pytest.mark.parametrize("kind", ["coasting", "any", "own class", "reference", "safety"])
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
            proof(Tube(law=replace(small_controllers()["any"], system=other)))
        else:
            proof(replace(small_controllers()[kind], system=other))
    assert f"system.{key}" in str(caught.value)


def test_an_equal_system_is_as_good_as_the_same_and_a_law_of_its_own_class_as_another():
    safety, coasting = small_safety(), small_controllers()["coasting"]
    law = AnyThrust("any", replace(safety.problem.system), safety.reference, safety.tracking)
    assert proof(law).guarantee == "proved"
    assert proof(Tube(law=law)).modes.tolist() == proof(law).modes.tolist()
    assert proof(Tube()).modes.tolist() == proof(coasting).modes.tolist()
    with pytest.raises(ScenarioError, match="must have steps of 30 s"):
        replace(coasting, own=replace(coasting.own, delta=15.0))


def test_a_plain_system_counts_as_one_without_errors():
    safety, law = small_safety(), small_controllers()["coasting"]
    craft = safety.problem.system
    plain = LinearSystem(*(getattr(craft, part.name) for part in fields(LinearSystem)))
    plain_law = replace(law, system=plain, own=replace(law.own, system=plain))
    assert proof(plain_law).modes.tolist() == proof(law).modes.tolist()
    wrong = replace(craft, thrusters=Thrusters(along=0.1))
    with pytest.raises(ScenarioError, match=r"system\.thrusters\.along: got 0\.0; must be"):
        check_controller(plain_law, replace(safety, problem=replace(safety.problem, system=wrong)))


def grids():
    law = small_controllers()["coasting"]
    path, tracking = law.own, law.tracking
    yield "period", replace(law, tracking=Tracking(law.system, tracking.gain, Feedback(3), 30.0))
    yield "tracking copied", replace(law, tracking=replace(tracking))
    yield "reference copied", replace(law, reference=replace(law.reference), own=law.reference)
    yield "too short", replace(law, own=Reference(path.system, 30.0, path.chi[:31], path.nu[:30]))
    yield "not finite", replace(law, own=replace(path, nu=np.full_like(path.nu, np.nan)))
    yield "inputs missing", replace(law, own=replace(path, chi=path.chi[:-1]))


@pytest.mark.parametrize("law", [pytest.param(law, id=name) for name, law in grids()])
def test_nothing_on_another_grid_or_reference_is_taken(law):
    with pytest.raises(ScenarioError, match="must"):
        proof(law)


def altered():
    safety, problem = small_safety(), small_problem()
    wider = Zonotope.box(problem.initial_set.c, [4, 4, 4, 0.01, 0.01, 0.01])
    debris = BoxObstacle("more", [0.0, 300.0, 0.0], [5.0] * 3)
    displaced = BoxObstacle("debris", [125.0, 235.0, 0.0], [25.0] * 3)
    changes = {"K": 50, "delta": 15.0, "period": 2.0, "initial_set": wider}
    for key, value in (changes | {"system": replace(problem.system, w_max=1e-4)}).items():
        yield key, replace(safety, problem=replace(problem, **{key: value}))
    for name, unsafe in (("one more", (*problem.unsafe, debris)), ("moved", (displaced,))):
        yield name, replace(safety, problem=replace(problem, unsafe=unsafe))
    yield "S clips", replace(safety, controller=replace(safety.controller, clips=True))
    yield "another gain", replace(safety, controller=replace(safety.controller, gain=problem.gains[0]))
    yield "S is any", replace(safety, controller=small_controllers()["any"])
    faster, end = small_safety(2.0), safety.end
    yield "another reference", replace(safety, reference=faster.reference)
    yield "smaller start", replace(safety, start=Zonotope.point(safety.start.c))
    sets = get_recover("polytope", faster.clearance, faster.bounds)
    yield "sets of another", replace(safety, recoverable=sets)
    later = end.until + 1 if np.isfinite(end.until) else 1e9
    yield "end moved", replace(safety, end=replace(end, until=later))
    other = "one_period" if end.horizon == "infinite" else "infinite"
    yield "end for ever", replace(safety, end=replace(end, horizon=other))
    bounds = replace(safety.bounds, gamma_position=safety.bounds.gamma_position / 50)
    yield "kinder bounds", replace(safety, bounds=bounds, recoverable=BallSets(safety.clearance, bounds))
    chi, nu, K = safety.reference.chi, safety.reference.nu, problem.K
    shift = np.zeros_like(chi)
    shift[5:, 1] = 0.01
    yield "a jump", assembled(safety, replace(safety.reference, chi=chi + shift))
    yield "other inputs", assembled(safety, replace(safety.reference, nu=0.999 * nu))
    yield "no tail", assembled(safety, replace(safety.reference, chi=chi[: K + 1], nu=nu[:K]))
    zero_input, excessive = np.zeros_like(nu), np.zeros_like(nu)
    excessive[:3] = -2 * problem.system.u_max
    for name, inputs in (("through the obstacle", zero_input), ("more thrust than there is", excessive)):
        reference = Reference.propagate(problem.system, problem.delta, chi[0], inputs)
        yield name, assembled(safety, reference)


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
    rebuilt = assembled(safety, replace(safety.reference))
    assert synthesize(rebuilt, experimental=[], rules=SwitchingRules()).guarantee == "proved"
    balls = replace(safety, recoverable=get_recover("ball", safety.clearance, safety.bounds))
    assert proof(small_controllers()["coasting"], safety=balls).guarantee == "proved"


def test_safety_of_another_scenario_is_refused_and_that_of_the_same_is_not():
    scenario, schedule = synthesised()
    second = synthesize(scenario, schedule.safety)
    assert second.modes.tolist() == schedule.modes.tolist()
    relaxed = scenario.with_assignments(["schedule.min_dwell_steps=2"])
    assert synthesize(relaxed, schedule.safety).guarantee == "proved"
    with pytest.raises(ScenarioError, match="must be"):
        synthesize(load_scenario("static"), schedule.safety)
    with pytest.raises(ScenarioError, match="must be"):
        synthesize(schedule.safety.problem, get_safety(small_problem()))


class Tube:
    """A law of a class of its own, which says little of itself; its tube may be tampered with."""

    name = "tube"

    def __init__(self, change=lambda tube: tube, law=None):
        self.change, self.law = change, law or small_controllers()["coasting"]

    def __getattr__(self, key):
        if key in ("command", "system"):
            return getattr(self.law, key)
        raise AttributeError(key)

    def propagate(self, start, k):
        return self.change(self.law.propagate(start, k))


TUBES = [
    (lambda f: None, "must return"),
    (lambda f: replace(f, states=f.states[:-1]), "states"),
    (lambda f: replace(f, intersample=f.intersample[:, :3]), "intersample"),
    (lambda f: replace(f, intersample=-f.intersample), "must not be negative"),
    (lambda f: replace(f, intersample=np.nan * f.intersample), "must not be negative"),
    (lambda f: replace(f, end=Zonotope.point(np.zeros(3))), "end"),
    (lambda f: replace(f, end=Zonotope.point(f.end.c)), "must contain its last node"),
    (lambda f: replace(f, states=0.5 * np.eye(6) @ f.states), "must contain the set it starts from"),
]


@pytest.mark.parametrize(("change", "told"), TUBES)
def test_a_tube_that_is_none_is_refused(change, told):
    with pytest.raises(ScenarioError, match=told):
        proof(Tube(change))


def test_a_tube_that_is_refused_is_not_flown():
    assert proof(Tube()).share() > 0
    assert proof(Tube(lambda f: replace(f, refused="its command may exceed a limit"))).share() == 0
