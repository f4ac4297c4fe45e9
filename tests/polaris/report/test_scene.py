"""Layers of scenes: every kind of unsafe set, at rest and moving, in space, in the plane and on the line."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from polaris.model.craft import Craft
from polaris.model.hill import clohessy_wiltshire
from polaris.model.scene.keep_in import KeepInCone, KeepInPolytope
from polaris.model.scene.obstacle import RigidObstacle
from polaris.model.scene.obstacles import BallObstacle, BoxObstacle, PolytopeObstacle
from polaris.model.scene.satellite import SatelliteObstacle
from polaris.model.scene.shapes import PolytopeShape
from polaris.planning.goals import Box, EllipticalNMT, Goal, GoalConditions, LinearNMT, StationaryPoint
from polaris.planning.reference import Reference
from polaris.report.html.scene import scene_data
from polaris.report.scene.items import plane_gap
from polaris.report.scene.scene import describe, shown_axes
from polaris.report.scene.timelines import proven_distance
from polaris.runs.plot_data import PlotData, TubeData
from reach.sets.zonotope import Zonotope

K, DELTA, Q = 6, 20.0, 2


def integrator(d):
    """A double integrator in d dimensions."""
    zero, one = np.zeros((d, d)), np.eye(d)
    A = np.block([[zero, one], [zero, zero]])
    B = np.vstack([zero, one])
    return Craft(A, B, B, np.ones(d), 0.01)


def picture(system, obstacles, goal):
    """A drift from one corner, with a tube of 1 m about it."""
    d = system.d
    start = np.r_[np.full(d, -60.0), np.full(d, 1.0)]
    reference = Reference.propagate(system, DELTA, start, np.zeros((K, system.m)))
    generators = np.broadcast_to(np.eye(d), (K, Q + 1, d, d))
    tube = TubeData(reference.fine(Q) @ system.position.T, generators, np.full((K, Q, d), 0.1))
    begin, craft = Zonotope.box(start, np.full(2 * d, 2.0)), Craft.from_system(system)
    return PlotData("drift", craft, tuple(obstacles), goal, begin, reference, K, tube=tube)


def at(layer, t):
    """Coordinates (dim, N) of a layer at t, as the page's script finds them; None if there are none."""
    times = np.array(layer["t"])
    points = np.array(layer["frames"][int(np.searchsorted(times, t, side="right")) - 1]["p"])
    shift = [np.interp(t, times, axis) for axis in layer["shift"]]
    return points + np.array(shift)[:, None] if points.size else None


class Rod(RigidObstacle):
    """An obstacle of a kind that figures do not know: a cylinder along the third axis."""

    name, path, velocity = "rod", "obstacles[0]", None
    center = np.array([10.0, -30.0, 0.0])
    cover = PolytopeShape(np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]]), np.full(4, 5.0))

    @property
    def shape(self):
        return SimpleNamespace(signed_distance=lambda p: np.linalg.norm(p[..., :2], axis=-1) - 5.0)


class Near(Goal):
    """A goal of a kind that figures do not know: the position within 4 m of a point on every axis."""

    n = 6

    @property
    def conditions(self):
        G, g = np.vstack([np.eye(3, 6), -np.eye(3, 6)]), np.r_[24.0, 4, 4, -16, 4, 4]
        return GoalConditions(np.zeros((0, 6)), np.zeros(0), G, g)

    def describe(self):
        return "near a point"


def scene_of(picture, paths):
    """The scene of a page."""
    return scene_data(describe(picture, paths, shown_axes(picture, paths)))


def named(scene):
    return {layer["name"]: layer for layer in scene["layers"]}


@pytest.fixture(scope="module")
def space():
    hill = clohessy_wiltshire(0.00113, 12.0, 0.2)
    obstacles = [
        BallObstacle("ball", [0, 0, 0], 10.0, velocity=[0.5, 0, 0]),
        BoxObstacle("box", [10, -30, 5], [4, 5, 6]),
        PolytopeObstacle("wall", [[0, 1.0, 0]], [-80.0], unbounded=True),
        PolytopeObstacle("shutter", [[0, -1.0, 0]], [-90.0], velocity=[0, -0.2, 0], unbounded=True),
        SatelliteObstacle("visitor", [20, 40, 0, 0, -0.1, 0], [1, 1, 1, 0.01, 0.01, 0.01], 8.0),
        KeepInCone("sight", [0, -100, 0], [0, 1, 0], 1.0),
        KeepInPolytope("corridor", [[0, 0, 1.0], [0, 0, -1.0]], [90.0, 90.0]),
    ]
    return picture(hill, obstacles, EllipticalNMT(0.00113, 20.0, 40.0))


@pytest.fixture(scope="module")
def scene(space):
    return scene_of(space, [])


def test_sets_are_where_they_are_at_each_time(scene):
    layers = named(scene)
    meshes = {
        "ball",
        "box",
        "wall",
        "shutter",
        "visitor",
        "visitor: its bounds",
        "sight (stay inside)",
        "goal",
    }
    assert {name for name, layer in layers.items() if layer["kind"] == "mesh"} >= meshes
    assert "corridor (stay inside)" not in layers  # its faces are out of view
    assert {"safe reference", "start", "initial set", "reachable now", "sight: its sides"} <= set(layers)
    assert scene["space"] == 3 and scene["axes"][0].startswith("Along-track")
    box, (low, high) = np.array(layers["box"]["p"]), np.array(scene["range"]).T
    assert np.allclose(box.min(axis=1), [-35, 6, -1]) and np.allclose(box.max(axis=1), [-25, 14, 11])
    for name in ("wall", "sight (stay inside)"):  # cut to the scene
        points = np.array(layers[name]["p"]).T
        assert np.all(points >= low - 1e-3) and np.all(points <= high + 1e-3)
    ball = layers["ball"]
    middle = np.array(ball["p"]).mean(axis=1) + np.array(ball["shift"])[:, -1]
    assert np.allclose(middle, [0, 0.5 * K * DELTA, 0], atol=1e-4) and ball["t"][-1] == K * DELTA
    for t in np.linspace(0, K * DELTA, 1001):  # between its frames too
        points = at(layers["shutter"], t)
        assert points is None or points[0].min() == pytest.approx(90 - 0.2 * t, abs=1e-3)
    assert points is not None


def test_timed_cover_holds_the_satellite_wherever_it_may_be(space, scene):
    layers = named(scene)
    cover = layers["visitor: its bounds"]
    visitor = space.obstacles[4]
    (timed,) = visitor.timed_polytopes(space.system, DELTA, K)
    for t in np.linspace(0, K * DELTA, 301)[:-1]:
        points, (k, s) = at(cover, t), divmod(t / DELTA, 1)
        offsets = (1 - s) * timed.offsets[int(k), 0] + s * timed.offsets[int(k), 1]
        excess = (timed.normals[:, [1, 0, 2]] @ points).max(axis=1) - offsets
        assert excess.min() > -2e-3 and excess.max() < 1.0  # what the proof uses then, not in all the step
        centre = visitor.centre(t, space.system)[[1, 0, 2]]
        for axis in range(3):  # at least the ball and the half widths, to either side
            assert points[axis].max() >= centre[axis] + 9 - 1e-3
            assert points[axis].min() <= centre[axis] - 9 + 1e-3


def test_tube_contains_the_reference(space, scene):
    tube = named(scene)["reachable now"]
    assert tube["kind"] == "mesh" and len(tube["frames"]) == K * Q
    centre = space.tube.centre.reshape(K, Q + 1, 3)[..., [1, 0, 2]]
    for number, frame in enumerate(tube["frames"]):
        points, (k, part) = np.array(frame["p"]).T, divmod(number, Q)
        for node in centre[k, part : part + 2]:
            assert np.all(points.min(axis=0) <= node - 1.09) and np.all(points.max(axis=0) >= node + 1.09)


@pytest.mark.parametrize(
    "goal",
    [
        LinearNMT(0.00113, 30.0, 10.0),
        StationaryPoint(np.zeros(6)),
        Box(np.zeros(6), np.full(6, 5.0)),
        Box(np.zeros(6), np.r_[np.full(3, 5.0), np.full(3, np.inf)]),
        Box(np.zeros(6), np.full(6, np.inf)),
    ],
)
def test_other_goals_are_drawn_if_they_have_a_place(space, goal):
    layers = named(scene_of(picture(space.system, [], goal), []))
    assert ("goal" in layers) == (not np.isinf(getattr(goal, "half_widths", np.zeros(3))[:3]).any())


def test_new_kinds_are_drawn_without_being_known():
    pictured = picture(integrator(3), [Rod()], Near())
    layers = named(scene_of(pictured, []))
    rod, goal = (np.array(layers[name]["p"]) for name in ("rod", "goal"))
    assert (
        np.allclose([rod[:2].min(axis=1), rod[:2].max(axis=1)], [[5, -35], [15, -25]]) and np.ptp(rod[2]) > 10
    )
    assert np.allclose([goal.min(axis=1), goal.max(axis=1)], [[16, -4, -4], [24, 4, 4]])
    assert np.isfinite(plane_gap(Rod(), pictured, [0, 1])).all()


def test_sets_in_the_plane_are_areas_and_fill_the_frame():
    kinds = [BallObstacle("ball", [0, 0], 5.0, velocity=[0.1, 0])]
    kinds.append(KeepInCone("sight", [-100, -100], [1, 1], 0.5))
    kinds.append(PolytopeObstacle("wall", [[0.0, -1.0]], [-70.0], unbounded=True))
    kinds.append(SatelliteObstacle("other", [20, 20, 0, 0], [1, 1, 0, 0], 3.0))
    goal = Box(np.zeros(4), np.r_[np.inf, 5.0, np.inf, np.inf])
    scene = scene_of(picture(integrator(2), kinds, goal), [])
    layers, (low, high) = named(scene), scene["range"][0]
    for name in ("ball", "other", "other: its bounds", "reachable now", "wall"):
        assert layers[name]["kind"] == "area"
    wall, ends = np.array(layers["wall"]["p"]), np.array(layers["goal"]["p"])
    assert wall[0].min() < low and wall[0].max() > high and wall[1].min() == 70
    assert np.allclose([ends.min(axis=1), ends.max(axis=1)], [[low, -5], [high, 5]], rtol=1e-4)
    assert layers["sight (stay inside)"]["kind"] == "line"


def test_motion_in_a_plane_of_space_is_drawn_in_it_unless_a_set_is_passed_above():
    system, goal = integrator(3), StationaryPoint(np.zeros(6))
    start = np.r_[-60.0, -60.0, 0.0, 1.0, 1.0, 0.0]
    reference = Reference.propagate(system, DELTA, start, np.zeros((K, 3)))
    aside, above = (
        BallObstacle("aside", [40.0, -40.0, 0.0], 10.0),
        BallObstacle("above", [0.0, 0.0, 12.0], 10.0),
    )
    for sets, dim in (((aside,), 2), ((aside, above), 3)):
        box = Zonotope.box(start, np.ones(6))
        scene = scene_of(PlotData("flat", system, sets, goal, box, reference, K), [])
        assert scene["space"] == dim and len(scene["axes"]) == len(scene["range"]) == dim
        assert all(len(layer.get("p", [0] * dim)) == dim for layer in scene["layers"])
        kinds = {layer["kind"] for layer in scene["layers"]} & {"area", "mesh"}
        assert kinds == {"area" if dim == 2 else "mesh"}


def test_scene_on_the_line_is_drawn_over_time():
    obstacles = [
        BoxObstacle("door", [100.0], [5.0], velocity=[-0.1]),
        KeepInPolytope("track", [[1.0], [-1.0]], [120.0, 90.0]),
    ]
    scene = scene_of(picture(integrator(1), obstacles, StationaryPoint(np.zeros(2))), [])
    door = np.array(named(scene)["door"]["p"])
    assert scene["axes"][0] == "Time (s)" and not scene["equal"] and scene["space"] == 2
    assert door[0].max() == K * DELTA and door[1].max() <= scene["range"][1][1]
    rims = [layer["p"][1] for layer in scene["layers"] if layer["name"] == "track (stay inside)"]
    assert rims == [[-90, -90], [120, 120]]  # where they are, whatever is shown
    assert scene["range"][1][0] < -90 and scene["range"][1][1] > 120
    assert named(scene)["goal"]["p"] == [[K * DELTA], [0]]


def test_no_point_of_the_tube_is_nearer_than_what_is_proven(space):
    rng = np.random.default_rng(0)
    bound = proven_distance(space)
    assert bound.shape == (K, Q) and np.all(bound >= 0) and bound.max() > 10
    nodes = space.reference.fine(8)[:K] @ space.system.position.T
    for k, part in itertools.product(range(K), range(Q)):
        for step in range(part * 4, part * 4 + 5):
            t = (k + step / 8) * DELTA
            points = nodes[k, step] + rng.uniform(-1, 1, (50, 3))
            near = [o.signed_distance(t, points, space.system).min() for o in space.obstacles]
            assert min(near) >= bound[k, part] - 1e-9 or bound[k, part] == 0
