"""The numbers of RTAEval, defect by defect, beside the right ones. docs/traces.md lists the defects."""

import gzip
import json
from pathlib import Path

import numpy as np
import pytest

from polaris.runs.files.tables import strict
from polaris.traces import (
    AgentTrace,
    BallTrace,
    Heading,
    PointTrace,
    PolytopeTrace,
    RectangleTrace,
    Trace,
    evaluate_legacy,
    evaluate_trace,
    parse_trace,
)
from tests.polaris.traces.traces import agent, entry, trace

CUBE = np.array([[[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]])
CUBE_OF_4 = PolytopeTrace(np.zeros(1), CUBE, np.full((1, 6), 2.0))
T = np.arange(3.0)


def both(flight, **options):
    """(ours, what RTAEval's methods return) of agent a; velocities are differences, as defect 9 demands."""
    ours = evaluate_trace(flight, velocity="differences", **options).agents["a"]
    legacy = evaluate_legacy(flight, velocity="differences", **options)["a"]
    return ours, legacy


def flown(p, v, n=6, **sets):
    """Three seconds from p at v; n states, 0 after the position."""
    states = np.zeros((3, n))
    states[:, : len(p)] = np.asarray(p, dtype=float) + T[:, None] * np.asarray(v, dtype=float)
    return Trace({"a": AgentTrace(T, states, np.array([2, 2, 2]))}, sets)


def ball(center, radius):
    return BallTrace(np.zeros(1), np.array([center], dtype=float), np.array([radius], dtype=float))


def test_1_distances_use_the_wrong_entries():
    """A true 8 m from a ball, and from a box, read 0: (y, z, 4th state) is the origin."""
    box = RectangleTrace(np.zeros(1), np.zeros((1, 3)), np.full((1, 3), 4.0))
    right = pytest.approx(8)  # polytopes are
    for item, printed in ((ball([0, 0, 0], 2), 0), (box, 0), (CUBE_OF_4, right)):
        ours, legacy = both(flown([10, 0, 0], [0, 0, 0], s=item))
        assert ours.unsafe[0].distance.min == right
        assert legacy["compute_dists"] == (printed, printed, {"s": printed})
    _, legacy = both(Trace({"a": AgentTrace(T, np.ones((3, 3)))}, {"s": ball([0, 0, 0], 1)}))
    assert legacy["compute_dists"].startswith("raises: fewer states")


def test_2_ttc_has_no_sign_no_miss_and_no_zero():
    """In one axis with the offset of defect 1 made harmless: the second state repeats the first."""

    def case(x, v, other=0.0):
        p = x + T * v
        states = np.column_stack([p, p, np.full(3, other)])
        flight = Trace({"a": AgentTrace(T, states)}, {"s": ball([0], 1)})
        ours, legacy = both(flight, dims=1)
        return ours.unsafe[0].ttc, tuple(part["s"] for part in legacy["compute_unsafe_TTC"])

    ours, legacy = case(10, -2)  # approaching: 4.5 s, and right
    assert (ours.max, legacy[1]) == (4.5, 4.5)
    ours, legacy = case(10, 2)  # moving away: inf, and yet 4.5 s
    assert (ours.min, legacy[0]) == (np.inf, 4.5)
    ours, legacy = case(10, 0)  # at rest: inf, both
    assert ours.min == np.inf and legacy == (np.inf, np.inf, np.inf)
    ours, legacy = case(0, 0)  # at rest inside, at the centre: now, and nan
    assert ours.max == 0 and all(np.isnan(value) for value in legacy)


def test_3_polytopes_get_a_distance_of_the_set_before():
    """Its last distance there, at all instants, over the speed towards the polytope's nearest point."""
    ours, legacy = both(flown([10, 0, 0], [-2, 0, 0], s=CUBE_OF_4))
    assert ours.unsafe[0].ttc.max == pytest.approx(4)
    assert legacy["compute_unsafe_TTC"] == "raises: no distance before it"
    _, legacy = both(flown([10, 5, 0], [-2, 0, 0], b=ball([100, 50, 0], 1), s=CUBE_OF_4))
    # The entries read for the last distance are (y, z, 0) = (5, 0, 0); the nearest point is (2, 2, 0).
    times = [(np.hypot(95, 50) - 1) / (2 * (8 - 2 * t) / np.hypot(8 - 2 * t, 3)) for t in T]
    actual = [part["s"] for part in legacy["compute_unsafe_TTC"]]
    assert actual == pytest.approx([min(times), max(times), np.mean(times)])
    for d, reason in ((2, "a polytope's line"), (1, "polytopes need")):
        item = PolytopeTrace(np.zeros(1), CUBE[:, : 2 * d, :d], np.full((1, 2 * d), 2.0))
        _, legacy = both(flown([10, 0][:d], [-2, 0][:d], b=ball([0, 0][:d], 1), s=item))
        assert legacy["compute_unsafe_TTC"].startswith(f"raises: {reason}")


def two(p, v, q, w):
    """Agents a and b, at p and q with velocities v and w."""
    agents = {name: flown(*motion).agents["a"] for name, motion in (("a", (p, v)), ("b", (q, w)))}
    return both(Trace(agents), dims=len(p))


def test_4_agents_lose_z():
    ours, legacy = two([0, 0, 0], [0, 0, 0], [3, 4, 12], [0, 0, 0])
    assert ours.others[0].distance.min == 13
    assert legacy["compute_agent_dists"] == (5, 5, {"b": 5})


@pytest.mark.parametrize("gap, speeds, true", [(10, (1, 1), 5), (12, (2, 1), 4)])
def test_5_agents_head_on_never_meet(gap, speeds, true):
    """The one that flies at a heading of pi has sin(pi) = 1e-16 of its speed to the side."""

    def flying(x, heading, speed):
        states = np.column_stack([x + T * speed * np.cos(heading), T * 0, T * 0 + heading, T * 0 + speed])
        return AgentTrace(T, states)

    flight = Trace({"a": flying(0, 0.0, speeds[0]), "b": flying(gap, np.pi, speeds[1])})
    velocity = Heading(3, (2,))
    ours = evaluate_trace(flight, dims=2, velocity=velocity, agent_radius=1e-9).agents["a"]
    legacy = evaluate_legacy(flight, dims=2, velocity=velocity)["a"]
    assert ours.others[0].ttc.max == pytest.approx(true)
    assert legacy["compute_agent_TTC"] == ({"b": 1e20}, {"b": 1e20}, {"b": 1e20})


@pytest.mark.parametrize(
    "modes, legacy, shares, switches",
    [
        ([1, 1, 1, 1], (0, 1, 4), {"normal": 1}, 0),
        ([2, 2, 2, 2], (1, 0, 0), {"untrusted": 1}, 0),
        ([3, 2, 3, 3], (0.25, 0.75, 3), {"untrusted": 1 / 3, "safety": 2 / 3}, 2),
        ([2, 1, 3, 3], (0.25, 0.75, 1), {"untrusted": 1 / 3, "normal": 1 / 3, "safety": 1 / 3}, 2),
        ([3, 1, 3, 1], (0, 1, 3), {"safety": 2 / 3, "normal": 1 / 3}, 3),
    ],
)
def test_6_normal_is_safety_and_a_switch(modes, legacy, shares, switches):
    ours, old = both(parse_trace(trace({"a": agent([[t, 0.0] for t in range(4)], modes)})))
    assert old["controllerUsage"] == legacy
    assert {name: share for name, share in ours.usage.items() if share} == pytest.approx(shares)
    assert ours.switches == switches


def test_7_depth_is_lost():
    ours, legacy = both(flown([0.5, 0, 0], [0, 0, 0], s=CUBE_OF_4))
    assert ours.unsafe[0].distance.min == pytest.approx(-1.5)
    assert legacy["compute_dists"][0] == 0


def test_8_points_and_nothing_to_measure_raise():
    point = PointTrace(np.zeros(1), np.array([[2.0, 0, 0]]))
    ours, legacy = both(flown([10, 0, 0], [-1, 0, 0], b=ball([0, 0, 0], 2), s=point))
    assert ours.unsafe[1].distance.max == 8
    assert legacy["compute_dists"] == "raises: a point gets no distances"
    # Its time to collision is that of the ball's last instant, held.
    assert legacy["compute_unsafe_TTC"][0]["s"] == legacy["compute_unsafe_TTC"][1]["s"] == 0
    ours, legacy = both(flown([10, 0, 0], [0, 0, 0], s=point))
    assert len(ours.unsafe) == 1 and legacy["compute_unsafe_TTC"] == "raises: no distance before it"
    ours, legacy = both(flown([10, 0, 0], [0, 0, 0]), dims=3)
    assert legacy["compute_dists"] == legacy["compute_agent_dists"] == "raises: nothing to measure to"
    assert legacy["compute_unsafe_TTC"] == legacy["compute_agent_TTC"] == ({}, {}, {})
    once = AgentTrace(np.zeros(1), np.array([[10.0, 0, 0, 0, 0, 0]]))
    _, legacy = both(Trace({"a": once, "b": once}, {"s": ball([0, 0, 0], 2)}))
    for method in ("controllerUsage", "compute_unsafe_TTC", "compute_agent_TTC"):
        assert legacy[method] == "raises: one sample"


def test_9_velocity_vectors_are_unsupported():
    states = np.column_stack([10 - T, T * 0, T * 0, -np.ones(3), T * 0, T * 0])
    flight = Trace({"a": AgentTrace(T, states)}, {"s": ball([0, 0, 0], 2)})
    assert evaluate_trace(flight).agents["a"].unsafe[0].ttc.max == 8
    legacy = evaluate_legacy(flight)["a"]
    assert legacy["compute_unsafe_TTC"] == "raises: the states have no heading"


DATA = Path(__file__).parent / "data"


@pytest.mark.parametrize("stated", [False, True])
@pytest.mark.parametrize("kind", ["sim", "eval"])
@pytest.mark.parametrize("name, heading", [("acc_sim", Heading(1)), ("simpleDubins", Heading(5, (3, 4)))])
def test_equal_to_what_rtaeval_printed(name, heading, kind, stated):
    """For traces its own simulator and evaluator wrote; heading, pitch and speed are found without a word."""
    file = DATA / f"{name}_{kind if kind == 'sim' else 'eval_ego1'}.json.gz"
    flight = parse_trace(json.loads(gzip.decompress(file.read_bytes())))
    velocity = heading if stated else None
    agents = strict(evaluate_legacy(flight, velocity=velocity))
    printed = json.loads((DATA / f"{name}_rtaeval_results.json").read_text())["ego1"]
    expected = {key.split("@")[0]: value for key, value in printed.items() if key.endswith(kind)}
    assert len(expected) == 5
    for method, value in expected.items():
        for actual, number in zip(agents["ego1"][method], value, strict=True):
            assert actual == pytest.approx(number, rel=1e-13, abs=0), method


def test_10_stamps_and_modes_lag():
    """x = 10 - t, S from 2 s on: half of the time, where RTAEval counts the initial row in."""
    rows = [[0, 10.0], [0, 9.0], [1, 8.0], [2, 7.0], [3, 6.0]]
    flight = parse_trace(trace({"a": agent(rows, [2, 2, 2, 3, 3])}, s=entry("point", [0, 0])))
    legacy = evaluate_legacy(flight)["a"]
    assert legacy["controllerUsage"] == (0.6, 0.4, 1)
    ours = evaluate_trace(flight, restamp=True).agents["a"]
    assert (ours.usage["untrusted"], ours.usage["safety"]) == (0.5, 0.5)
    assert (ours.duration, ours.unsafe[0].distance.at, ours.unsafe[0].ttc.max) == (4, 4, 10)
    assert evaluate_trace(flight).agents["a"].duration == 3
