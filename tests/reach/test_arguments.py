"""Wrong arguments: every public function, every position, one `ReachError` each and no warning of numpy's."""

import inspect
import warnings
from dataclasses import fields

import numpy as np
import pytest
from scipy import sparse

import reach
from reach import Always, Ellipsoid, HPolytope, HybridOptions, Interval, LinearFlow, LinearSystem, Zonotope

BOX = Interval([-1.0, -1.0], [1.0, 1.0])
ZONOTOPE = Zonotope([0.0, 1.0], [[1.0, 0.5, 0.0], [0.0, 0.5, 1.0]])
STACK = Zonotope.stack([ZONOTOPE, ZONOTOPE])
POLYTOPE = BOX.to_polytope()
ROUND = Ellipsoid.ball([0.0, 0.0], 1.0)
A = np.array([[0.0, 1.0], [-1.0, -0.5]])
B = np.array([[0.0], [1.0]])
SYSTEM = LinearSystem(A, B, Interval([-1.0], [1.0]))
VARYING = reach.LTVSystem(reach.Varying(lambda t: A * (1 + t), slope=np.abs(A)), B, Interval([-1.0], [1.0]))
AUTOMATON = reach.HybridAutomaton(
    [reach.Mode("a", LinearSystem(A)), reach.Mode("b", LinearSystem(A))],
    [reach.Transition("a", "b", guard=HPolytope([[1.0, 0.0]], [0.5]))],
)
TRAJECTORY = reach.simulate_hybrid(AUTOMATON, [0.0, 1.0], 1.0, dt=0.1)
FLOW = LinearFlow.continuous(A, B, 0.1, 0.1)
POLICY = reach.Network((reach.Affine([[1.0, 0.5]], [0.1]), reach.Activation("tanh")))
LOOP = reach.NetworkLoop(A, B, B, 0.1, 0.1, POLICY, np.eye(2))
TUBE = reach.support_tube(SYSTEM, BOX, 1.0, np.eye(2), step=0.5)
SPAN, RNG, SAFE = (0.0, 1.0), np.random.default_rng(0), {"a": [Always(POLYTOPE)]}
CHOSEN = {"dt": 0.1, "policy": "random", "rng": RNG, "jumps": 3}
BOUNDED = {"tolerance": 0.1, "limit": [1.0, 1.0], "max_effort": 1e6}
SETS = {
    "interval": BOX,
    "zonotope": ZONOTOPE,
    "polytope": POLYTOPE,
    "half-space": HPolytope([[1.0, 0.5]], [1.0]),
    "ellipsoid": ROUND,
    "image": reach.AffineImage([[1.0, 0.3], [0.1, 1.0]], POLYTOPE, [0.0, 0.1]),
    "sum": reach.MinkowskiSum((ROUND, POLYTOPE)),
    "intersection": reach.Intersection((ROUND, POLYTOPE)),
    "stack": STACK,
}

CALLS = {
    "Activation": (reach.Activation, ("clip", -1.0, 1.0)),
    "Affine": (reach.Affine, (np.eye(2), [0.0, 0.0])),
    "Diagonal": (reach.Diagonal, ([1.0, 2.0], [0.0, 0.0])),
    "Network": (reach.Network, (POLICY.layers,)),
    "Network.__call__": (POLICY, ([0.0, 1.0],)),
    "Network.enclose": (POLICY.enclose, (ZONOTOPE, 0.1)),
    "NetworkLoop": (reach.NetworkLoop, (A, B, B, 0.1, 0.1, POLICY, np.eye(2))),
    "NetworkLoop.step": (LOOP.step, (ZONOTOPE, [0.0, 0.0], [0.0])),
    "NetworkLoop.tube": (LOOP.tube, (ZONOTOPE, 2, 30.0)),
    "NetworkTube.support": (LOOP.tube(ZONOTOPE, 2).support, (np.eye(2),)),
    "NetworkTube.at": (LOOP.tube(ZONOTOPE, 2).at, ([0.0, 0.1],)),
    "read_onnx": (reach.read_onnx, ("missing.onnx",)),
    "AffineImage": (reach.AffineImage, (np.eye(2), BOX, [0.0, 0.0])),
    "Always": (Always, (POLYTOPE, (0.0, 1.0))),
    "Ellipsoid": (Ellipsoid, ([0.0, 0.0], np.eye(2))),
    "Ellipsoid.ball": (Ellipsoid.ball, ([0.0, 0.0], 1.0)),
    "Ellipsoid.from_shape": (Ellipsoid.from_shape, ([0.0, 0.0], np.eye(2))),
    "Ellipsoid.sublevel": (Ellipsoid.sublevel, ([0.0, 0.0], np.eye(2), 2.0)),
    "HPolytope": (HPolytope, (np.eye(2), [1.0, 1.0])),
    "HybridAutomaton": (reach.HybridAutomaton, (AUTOMATON.modes, AUTOMATON.transitions, "a")),
    "Intersection": (reach.Intersection, ((BOX, ROUND),)),
    "Interval": (Interval, ([0.0, 0.0], [1.0, 1.0])),
    "Interval.around": (Interval.around, ([[0.0, 0.0], [1.0, 1.0]],)),
    "Interval.ball": (Interval.ball, ([0.0, 0.0], [1.0, 1.0])),
    "LTVSystem": (reach.LTVSystem, (A, B, Interval([-1.0], [1.0]), [0.0, 0.0], 0.0)),
    "LinearSystem": (LinearSystem, (A, B, Interval([-1.0], [1.0]), [0.0, 0.0], (), False, None)),
    "LinearFlow.continuous": (LinearFlow.continuous, (A, B, 0.1, 0.1)),
    "LinearFlow.sampled": (LinearFlow.sampled, (A, B, np.ones((1, 2)), B, 0.1, 0.1)),
    "LinearFlow.disturbance_support": (FLOW.disturbance_support, (np.eye(2), 3)),
    "LinearFlow.disturbance_nodes": (FLOW.disturbance_nodes, (3, 5.0)),
    "LinearFlow.norms": (FLOW.norms, (3,)),
    "MinkowskiSum": (reach.MinkowskiSum, ((BOX, ROUND),)),
    "Mode": (reach.Mode, ("a", LinearSystem(A), POLYTOPE)),
    "Never": (reach.Never, (POLYTOPE, (0.0, 1.0))),
    "Signal": (reach.Signal, ([0.0, 1.0], [[0.0], [1.0]])),
    "Signal.constant_pieces": (reach.Signal.constant_pieces, ([0.0, 1.0], [[0.0], [1.0]])),
    "Transition": (reach.Transition, ("a", "b", POLYTOPE, SPAN, SPAN, np.eye(2), [0.0, 0.0], BOX, True)),
    "Varying": (reach.Varying, (lambda t: A, np.abs(A), np.abs(A))),
    "Zonotope": (Zonotope, ([0.0, 0.0], np.eye(2))),
    "Zonotope.box": (Zonotope.box, ([0.0, 0.0], [1.0, 1.0])),
    "Zonotope.point": (Zonotope.point, ([0.0, 0.0],)),
    "Zonotope.stack": (Zonotope.stack, ([ZONOTOPE, ZONOTOPE],)),
    "Interval.stack": (Interval.stack, ([BOX, BOX],)),
    "ball_generators": (reach.ball_generators, (2, 1.0)),
    "clip_relaxation": (reach.clip_relaxation, (-1.0, 2.0, 1.0, 4)),
    "contains": (reach.contains, (BOX, ZONOTOPE, "auto", 100)),
    "discretize": (reach.discretize, (A, B, 0.1)),
    "disjoint": (reach.disjoint, (BOX, ROUND)),
    "enclosing_hull": (reach.enclosing_hull, (ZONOTOPE, ZONOTOPE)),
    "growth": (reach.growth, (A, 0.1)),
    "HybridOptions": (HybridOptions, (0.1, 0.1, 2, 5.0, "pca", 2)),
    "hybrid_tube": (reach.hybrid_tube, (AUTOMATON, BOX, 0.5, HybridOptions(0.1, jumps=2))),
    "largest_norm": (reach.largest_norm, (ZONOTOPE, 100, 1.0)),
    "support_tube, varying": (reach.support_tube, (VARYING, BOX, 0.5, np.eye(2)), {"step": 0.1}),
    "zonotope_tube, varying": (reach.zonotope_tube, (VARYING, BOX, 0.5), {"step": 0.1, "frame": np.eye(2)}),
    "meet_halfspace": (reach.meet_halfspace, (ZONOTOPE, [1.0, 0.0], 0.5)),
    "outline": (reach.outline, (ZONOTOPE,)),
    "powers": (reach.powers, (A, 3)),
    "reduce": (reach.reduce, (ZONOTOPE, 1.0, "pca")),
    "reduction_loss": (reach.reduction_loss, (ZONOTOPE, ZONOTOPE)),
    "replay_hybrid": (reach.replay_hybrid, (AUTOMATON, TRAJECTORY, 1e-8)),
    "simulate": (reach.simulate, (SYSTEM, [0.0, 0.0], [0.0, 1.0], [[0.5]])),
    "simulate_hybrid": (reach.simulate_hybrid, (AUTOMATON, [0.0, 1.0], 0.5), CHOSEN),
    "falsify_hybrid": (reach.falsify_hybrid, (AUTOMATON, BOX, SAFE, 0.3), {"dt": 0.1, "runs": 1, "rng": RNG}),
    "verify_hybrid": (reach.verify_hybrid, (AUTOMATON, BOX, SAFE, 0.3, HybridOptions(0.1)), {"dt": 0.1}),
    "state_scale": (reach.state_scale, (A - np.eye(2),)),
    "support_tube": (reach.support_tube, (SYSTEM, BOX, 0.5, np.eye(2)), BOUNDED),
    "support_tube, steps": (reach.support_tube, (SYSTEM, BOX, 0.5, np.eye(2)), {"step": 0.1}),
    "verify": (reach.verify, (SYSTEM, BOX, Always(POLYTOPE), 0.2), {"max_effort": 1e6}),
    "worst_case": (reach.worst_case, (SYSTEM, BOX, 0.5, [1.0, 0.0]), {"step": 0.1}),
    "worst_case, tolerance": (reach.worst_case, (SYSTEM, BOX, 0.5, [1.0, 0.0]), {"tolerance": 0.1}),
    "zonotope_tube": (reach.zonotope_tube, (SYSTEM, BOX, 0.5), {"tolerance": 0.1, "frame": np.eye(2)}),
    "SupportTube.at": (TUBE.at, ([0.1],)),
}
DIRECTION, POINT = ([[1.0, 0.5]],), ([1.0, 0.0],)
METHODS = {
    **dict.fromkeys(("support", "support_up", "support_down"), DIRECTION),
    **dict.fromkeys(("__add__", "__sub__", "support_vector", "__contains__"), POINT),
    **dict.fromkeys(("__and__", "__le__", "product"), (BOX,)),
    **dict.fromkeys(("__rmatmul__", "enclosing_zonotope", "norm_bound"), (np.eye(2),)),
    **dict.fromkeys(("corners", "to_polytope", "volume"), (100,)),
    **dict.fromkeys(("meet_halfspace", "intersect_halfspace"), ([1.0, 0.0], 0.5)),
    **dict.fromkeys(("vertices", "vertices_2d"), ()),
    "contains": ([0.0, 0.0], 1e-9),
    "__mul__": (2.0,),
    "__getitem__": (0,),
    "project": ([0],),
    "hull": (ZONOTOPE,),
    "reduce": (1.0, "pca"),
    "sample": (np.random.default_rng(0), 3),
    "inflate": ([0.1, 0.1],),
    "is_empty_within": ([1.0, 1.0],),
}
NUMBERS = (True, 0, -1, 2.5, -2.5, np.nan, np.inf, 1 + 2j, 1e300, np.datetime64("2020-01-01"))
LISTS = ([], [1.0], [np.nan, 0.0], ["a", "b"], [1.0, 2.0, 3.0], [[1.0], [2.0, 3.0]], [[np.inf, 1], [0, 1]])
LISTS += ([1e300, 1e300], [1e-320, 0.0], (1.0, 0.0), (0.0, np.nan), range(2), [BOX, None])
ARRAYS = (np.zeros((0, 2)), np.zeros((2, 0)), np.ones((2, 3)), np.ones((3, 2, 2)))
ARRAYS += (np.array([object(), None]), np.array(["x", "y"]), sparse.identity(2), sparse.identity(3))
OBJECTS = (None, "text", b"bytes", {}, {"a": 1}, {1, 2}, object(), len, Interval)
OBJECTS += (BOX, STACK, Interval([0.0], [1.0]), Interval([0.0] * 3, [1.0] * 3))
OBJECTS += (HPolytope([[1.0, 0.0], [-1.0, 0.0]], [-1.0, 0.0]), HPolytope([[1.0, 0.0]], [0.0]))
OBJECTS += (
    LinearSystem([[1.0]]),
    LinearSystem(A, discrete=True),
    SYSTEM,
    VARYING,
    AUTOMATON,
    Always(POLYTOPE),
)
WRONG = (*NUMBERS, *LISTS, *ARRAYS, *OBJECTS)


def _first(X):
    """Return the fields of a set, or of the first of a stack."""
    one = X[0] if getattr(X, "batch", ()) else X
    return [getattr(one, field.name) for field in fields(one)]


def attempt(call, args, more):
    """Return the error of a call that is no `reach.ReachError`, as text; None without one."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", reach.ReachWarning)
        warnings.simplefilter("error", RuntimeWarning)
        try:
            call(*args, **more)
        except reach.ReachError:
            return None
        except Exception as error:
            return f"{type(error).__name__}: {error}"
    return None


def faults(name, call, args, more=None):
    """Return the faults of a call with every wrong value in every place."""
    texts, more = [], more or {}
    good = attempt(call, args, more)
    if good is not None:
        texts.append(f"{name}: {good}")
    places = [*range(len(args)), *more]
    for place in places:
        for wrong in WRONG:
            positional, keywords = list(args), dict(more)
            (positional if isinstance(place, int) else keywords)[place] = wrong
            fault = attempt(call, positional, keywords)
            if fault is not None:
                texts.append(f"{name}, argument {place} = {str(wrong)[:40]!r}: {fault[:150]}")
    return texts


@pytest.mark.parametrize("name", CALLS)
def test_wrong_arguments_are_one_error(name):
    assert not faults(name, *CALLS[name])


@pytest.mark.parametrize("kind", SETS)
def test_wrong_arguments_of_methods_are_one_error(kind):
    X = SETS[kind]
    texts = []
    for method, args in METHODS.items():
        if hasattr(X, method):
            call = getattr(X, method)
            count = len(inspect.signature(call).parameters)
            args = (type(X)(*_first(X)),) if method == "hull" else args[:count]
            texts += faults(f"{kind}.{method}", call, args)
    assert not texts


def test_every_public_function_is_tried():
    values = "Answer ConvexSet Flowpipes HybridTrajectory HybridTube HybridVerdict LinearFlow NetworkTube"
    values += " NormBracket ReachError ReachWarning Segment SupportTube Trajectory Unresolved Verdict Visit"
    values += " ZonotopeTube"
    assert set(reach.__all__) - {name.split(".")[0] for name in CALLS} <= set(values.split())
