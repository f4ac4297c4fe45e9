"""From outside: whatever is violated at the start, the filter's way back violates no separation."""

import numpy as np
import pytest

from polaris.inspection.constraints.allowable_set import allowable
from polaris.inspection.constraints.families import Families
from polaris.inspection.constraints.motion import SampledData
from polaris.inspection.filters.explicit import SHARINGS, make_filter
from polaris.inspection.inspection import Inspection
from polaris.rta.projection import FAILED
from tests.sizes import fewer

ALL = ("centralized", *SHARINGS)
SPEEDS = ("phi3", "phi9", "phi10", "phi11")


def fly(q, families, sharing, x, seconds):
    """Without any desired thrust, the sun at 0 to begin with: least and last values."""
    filtering = make_filter(families, sharing)
    K, moves = len(x), [(part, *q.discretize(part)) for part in (0.5, 1.0)]
    least = allowable(q, x, np.zeros(K))
    for k in range(seconds):
        answer = filtering.batch(x, q.sun_angle(np.full(K, float(k))), np.zeros((K, q.deputies, 3)))
        assert (answer.status < FAILED).all() and np.abs(answer.u).max() <= q.thrust_max
        for part, Phi, Gamma in moves:
            after = x @ Phi.T + answer.u @ Gamma.T
            phi = allowable(q, after, q.sun_angle(np.full(K, k + part)))
            least = {name: np.minimum(least[name], phi[name]) for name in least}
        x = after
    return least, phi


def outside(q, K, rng):
    """States that violate any constraint but separations, in place or speed, near each other."""
    out = []
    while len(out) < K:
        kind, spread = rng.integers(0, 5), 10 ** rng.uniform(0.9, 1.7)
        middle = rng.standard_normal(3)
        if kind < 2:  # the cone that the sun opens
            middle *= [1.0, 0.2, 0.2]
            middle[0] = -abs(middle[0])
        middle *= 10 ** rng.uniform(1.5, 2.9) / np.linalg.norm(middle)
        p = middle + rng.standard_normal((q.deputies, 3)) * spread
        r = np.linalg.norm(p, axis=1, keepdims=True)
        if kind == 2:
            p *= rng.uniform(1.0, 1.1) * q.distance_max / r
        v = rng.standard_normal((q.deputies, 3))
        v *= (q.docking_speed + q.nu_1 * r) / np.linalg.norm(v, axis=1, keepdims=True)
        v *= rng.uniform(1, 2, (q.deputies, 1)) if kind == 3 else rng.uniform(0, 0.8) * rng.integers(0, 2)
        out.append(np.concatenate([p, v], axis=1))
    return np.array(out)


def recoveries(N, preset, sharing, sampled, K, seconds, seed):
    """Check that separations kept at the start (in place and by their barrier) stay kept; how many."""
    q = Inspection(deputies=N)
    families = Families(q, preset, (), sampled)
    x = outside(q, K, np.random.default_rng(seed))
    h, start, count = families(x, np.zeros(K)).h, allowable(q, x, np.zeros(K)), 0
    least, last = fly(q, families, sharing, x, seconds)
    for name, phi in (("chief_separation", "phi1"), ("deputy_separation", "phi2")):
        selected = np.array(families.family) == name
        good = (h[:, selected] >= 0) & (start[phi] >= 0)
        assert (least[phi][good] >= 0).all(), (N, preset, sharing, phi, least[phi][good].min())
        count += good.sum()
    return count, last


@pytest.mark.parametrize("sharing", ALL)
@pytest.mark.parametrize("sampled", [None, SampledData(1.0)])
def test_no_way_back_violates_a_separation(sharing, sampled):
    for N, preset in ((3, "polaris"), (2, "linear")):
        count, last = recoveries(N, preset, sharing, sampled, 6, 60, 3)
        assert count > 6 * N
        for name in SPEEDS:
            assert last[name].min() >= -0.02, name


@pytest.mark.slow
@pytest.mark.parametrize("sharing", ALL)
@pytest.mark.parametrize("sampled", [None, SampledData(1.0)])
def test_many_ways_back_violate_no_separation(sharing, sampled):
    for N, preset in ((1, "linear"), (3, "afrl"), (5, "linear")):
        recoveries(N, preset, sharing, sampled, 25, fewer(250, 60), 100 + N)
