"""Share of experimental control and size of the recoverable sets, by kind, on every bundled scenario.

    python benchmarks/recoverable.py

Sizes are radii of the largest ball ``norm(W e) <= r`` inside the sets (W the tracker's contraction
norm, the same for all kinds), averaged over the horizon, and volumes as a multiple of the `ball`'s.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from polaris.scenario.scenario import load_scenario
from polaris.synthesis.safety.get_safety import get_recover, get_safety
from polaris.synthesis.schedule.synthesize import synthesize

KINDS = ("ball", "polytope")
SCENARIOS = ("static", "dynamic", "keep_out", "hold_point", "robot")


def volumes(safety, sets, node, points=4000):
    """Volume of each set at a node over the volume of the ball there, by sampling rays in the norm W.

    The mean of (extent / radius)^n over random directions is the ratio of volumes of star-shaped
    sets. The extent along a ray is found by bisection on membership.
    """
    n = safety.problem.system.n
    rng = np.random.default_rng(0)
    rays = rng.normal(size=(points, n))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    rays = rays @ safety.tracking.W_inverse.T
    unit = sets["ball"].radius(node)
    ratios = {}
    for kind, set_ in sets.items():
        low, high = np.zeros(points), np.full(points, 60.0)
        for _ in range(16):
            middle = (low + high) / 2
            inside = set_.contains(node, rays * (unit * middle)[:, None])
            low, high = np.where(inside, middle, low), np.where(inside, high, middle)
        ratios[kind] = float(np.mean(low**n))
    return ratios


def main() -> None:
    print(f"{'scenario':<12}{'kind':<20}{'share of U':>11}{'radius':>9}{'volume / ball':>15}")
    for name in SCENARIOS:
        scenario = load_scenario(name)
        safety = get_safety(scenario)
        controllers = scenario.controllers(safety)
        sets = {kind: get_recover(kind, safety.clearance, safety.bounds) for kind in KINDS}
        nodes = np.linspace(0, safety.problem.K * safety.clearance.q - 1, 7).astype(int)
        volume = [volumes(safety, sets, int(node)) for node in nodes[1:-1:2]]
        for kind in KINDS:
            other = replace(safety, recoverable=sets[kind])
            if sets[kind].margin_at(0, safety.start).inside:
                share = f"{synthesize(scenario, other, controllers).share():.1%}"
            else:
                share = "Θ outside"
            radius = np.mean([sets[kind].radius(int(node)) for node in nodes])
            size = np.median([v[kind] for v in volume])
            print(f"{name:<12}{kind:<20}{share:>11}{radius:>9.3f}{size:>15.3g}", flush=True)


if __name__ == "__main__":
    main()
