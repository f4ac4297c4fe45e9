"""Planner benchmark: the tree, HiGHS and Gurobi on the same scenes; growth with steps and obstacles.

Run with ``python benchmarks/planner.py``.
"""

from __future__ import annotations

import argparse
from time import perf_counter, process_time

import numpy as np

from polaris.model.hill import clohessy_wiltshire
from polaris.model.scene.timed_polytope import TimedPolytope
from polaris.planning.goals import EllipticalNMT, StationaryPoint
from polaris.planning.problem import PlannerOptions, PlanProblem
from polaris.planning.solve import plan

ETA = 0.0012
CUBE = np.vstack([np.eye(3), -np.eye(3)])


def box(name, center, half, K, velocity=(0, 0, 0), delta=50.0):
    """Return a box that moves at constant velocity, as a timed polytope over K cells."""
    center, half, velocity = (np.broadcast_to(np.asarray(v, float), (3,)) for v in (center, half, velocity))
    t = np.arange(K + 1)[:, None] * delta
    at = center + velocity * t
    b = at @ CUBE.T + np.r_[half, half]
    return TimedPolytope(name, CUBE, np.stack([b[:-1], b[1:]], axis=1), static=not np.any(velocity))


def cone(K, apex, axis, half_angle, sides=8):
    """Facets of a polyhedral cone inscribed in a true one, each an unsafe half-space."""
    axis = np.asarray(axis, float) / np.linalg.norm(axis)
    e1 = np.linalg.svd(axis[None])[2][1]
    e2 = np.cross(axis, e1)
    angle = 2 * np.pi * (np.arange(sides) + 0.5) / sides
    slope = np.tan(half_angle) * np.cos(np.pi / sides)
    normals = np.cos(angle)[:, None] * e1 + np.sin(angle)[:, None] * e2 - slope * axis
    normals = -normals / np.linalg.norm(normals, axis=1)[:, None]
    return [
        TimedPolytope(f"cone {j}", n[None], np.full((K, 2, 1), n @ np.asarray(apex, float)), keep_in=True)
        for j, n in enumerate(normals)
    ]


def problem(
    unsafe, goal, K=60, delta=50.0, x0=(0, -1000, 0, 0, 0, 0), margin=10.0, extra=20.0, u=0.9, **options
):
    """Return a planning problem with one margin for all cells and facets."""
    system = clohessy_wiltshire(ETA, 10.0, 1.0)
    return PlanProblem(
        system,
        np.asarray(x0, float),
        K,
        delta,
        tuple(unsafe),
        tuple(np.full((K, len(b.normals)), margin) for b in unsafe),
        np.full((K, 3), u),
        goal,
        extra_margin=extra,
        **options,
    )


NMT = EllipticalNMT(ETA, 100.0, 250.0)
OTHER = (200, -900, 50, 0, 0, 0)


def scenes(K=60):
    """Return the scenes of the comparison; all but the first stand in the way of the cheapest transfer."""
    delta = 3000.0 / K
    easy = box("box", (100, -550, 0), 100, K)
    static = box("box", (-250, -600, 0), 120, K)
    wide = box("box", (-320, -650, 0), 150, K)
    keep_out = box("keep-out", (0, 0, 0), 50, K)
    big = box("keep-out", (0, 0, 0), 180, K)
    moving = box("box", (-700, -400, 0), 110, K, (0.25, 0, 0), delta)
    head_on = box("box", (-300, 400, 0), 110, K, (0.0, -0.5, 0), delta)
    hold = StationaryPoint(np.array([0, -100, 0, 0, 0, 0.0]))
    small = box("box", (0, -500, 0), 50, K)
    los = cone(K, (0, 0, 0), (0, -1, 0), np.deg2rad(30))
    at = {"K": K, "delta": delta}
    return {
        "box beside the way": problem([easy], NMT, **at),
        "static box": problem([static], NMT, **at),
        "static box, other start": problem([wide], NMT, x0=OTHER, **at),
        "box and keep-out": problem([static, keep_out], NMT, **at),
        "box and keep-out, coasting": problem([static, keep_out], NMT, tail_cells=2 * K, **at),
        "box and large keep-out": problem([static, big], EllipticalNMT(ETA, 150, 400), **at),
        "wide box, other start, keep-out": problem([wide, keep_out], NMT, x0=OTHER, **at),
        "box crossing and keep-out": problem([moving, keep_out], NMT, **at),
        "box head on and keep-out": problem([head_on, keep_out], NMT, **at),
        "cone, hold point, box": problem([*los, small], hold, margin=5.0, extra=10.0, **at),
        "distance: box and keep-out": problem([static, keep_out], NMT, objective="distance", extra=0.0, **at),
        "fuel: box and keep-out": problem([static, keep_out], NMT, objective="fuel", **at),
        "margin out of reach": problem([static, keep_out], NMT, extra=300.0, **at),
    }


def field(K, count, seed=0):
    """Return a corridor with `count` boxes scattered between the start and the target."""
    rng = np.random.default_rng(seed)
    delta = 3000.0 / K
    boxes = []
    for i in range(count):
        waypoint = np.array([-150.0, -930.0, 0.0]) + (i + 0.5) / count * np.array([-150.0, 750.0, 0.0])
        center = waypoint + rng.uniform(-1, 1, 3) * (40, 40, 20)
        boxes.append(box(f"box {i}", center, rng.uniform(30, 60), K))
    return problem(boxes, NMT, K=K, delta=delta, margin=5.0, extra=5.0)


def run(task, solver, limit):
    """Wall time, processor time and result of one solve."""
    start, cpu = perf_counter(), process_time()
    try:
        answer = plan(task, PlannerOptions(solver=solver, time_limit=limit))
        error = None
    except Exception as problem_found:  # a benchmark reports, it does not stop
        answer, error = None, problem_found
    return perf_counter() - start, process_time() - cpu, error, answer


def show(name, solver, seconds, cpu, error, answer):
    """Print one line."""
    start = f"{name:31s} {solver:6s} {seconds:7.2f} {cpu:7.2f} "
    if error is not None:
        print(start + f"{type(error).__name__}: {str(error)[:80]}", flush=True)
        return
    s = answer.stats
    print(
        start + f"{answer.delta_v:8.4f} {answer.margin:8.2f} {answer.gap:8.1e} {answer.status:10s} "
        f"{s['lps']:6.0f} {s['nodes']:6.0f} {s['rows']:6.0f} {s['cols']:5.0f} {s['binaries']:5.0f}",
        flush=True,
    )


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--limit", type=float, default=60.0, help="time limit per solve [s]")
    parser.add_argument("--part", choices=("all", "scenes", "growth"), default="all")
    parser.add_argument("--only", default="", help="scenes whose name contains this")
    args = parser.parse_args()
    head = f"{'':31s} {'':6s} {'wall s':>7s} {'cpu s':>7s} {'dv m/s':>8s} {'extra m':>8s} "
    head += f"{'gap':>8s} {'status':10s} "
    head += f"{'LPs':>6s} {'nodes':>6s} {'rows':>6s} {'cols':>5s} {'bin':>5s}"
    plan(problem([], NMT), PlannerOptions())  # loads the libraries
    if args.part != "growth":
        print(head)
        print("tree: the planner's default, linear programs by HiGHS; the others: the back end branches")
        solvers = {"tree": "facets", "HiGHS": "highs", "Gurobi": "gurobi"}
        ratios = {}
        for name, task in scenes().items():
            if args.only not in name:
                continue
            cpu_times = {}
            for label, solver in solvers.items():
                result = run(task, solver, args.limit)
                show(name, label, *result)
                optimal = result[2] is None and result[3].status == "optimal"
                cpu_times[label] = result[1] if optimal else float("nan")
            ratios[name] = cpu_times
        print("\nprocessor time over that of Gurobi (nan: no optimum in the time given)")
        for name, cpu_times in ratios.items():
            tree, highs = (cpu_times[label] / cpu_times["Gurobi"] for label in ("tree", "HiGHS"))
            print(f"{name:31s}  tree {tree:6.2f}   HiGHS {highs:6.2f}")
    if args.part != "scenes":
        print(head)
        for K in (30, 60, 120, 240):
            for count in (1, 2, 4, 8):
                show(f"K={K} obstacles={count}", "tree", *run(field(K, count), "facets", args.limit))


if __name__ == "__main__":
    main()
