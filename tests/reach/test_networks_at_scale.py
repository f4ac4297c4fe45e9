"""Networks of every size against sampled truth, small ones against their exact range, region by region."""

import numpy as np
import pytest

from reach.networks.layers import Activation, Affine
from reach.networks.network import Network
from reach.sets.zonotope import Zonotope
from tests.sizes import fewer

KINDS = [
    Activation("relu"),
    Activation("relu", 0.1),
    Activation("tanh"),
    Activation("sigmoid"),
    Activation("clip", -0.5, 1.0),
]


def drawn(rng, depth, width, scaling):
    """A random network: activations mixed, rows scaled by up to `scaling`, units dead or doubled."""
    sizes = [int(rng.integers(1, 7)), *(int(rng.integers(1, width + 1)) for _ in range(depth)), 2]
    layers = []
    for before, after in zip(sizes, sizes[1:], strict=False):
        W = rng.normal(size=(after, before)) / np.sqrt(before)
        W *= scaling ** rng.uniform(-1, 1, (after, 1))
        b = rng.normal(size=after) * scaling ** rng.uniform(-1, 1, after)
        fate = rng.random(after)
        W[fate < 0.1] = 0.0  # reads nothing
        b[(fate >= 0.1) & (fate < 0.2)] -= 1e3 * scaling  # never answers, or is saturated
        if after > 1 and fate[0] > 0.5:
            W[1], b[1] = -W[0], -b[0]
        layers += [Affine(W, b), KINDS[int(rng.integers(len(KINDS)))]]
    return Network(tuple(layers[:-1])), sizes[0]


def held(seed, depth, width, scaling, samples):
    """Check one enclosure against samples, corners and points on edges; the share of it that they fill."""
    rng = np.random.default_rng(seed)
    net, n = drawn(rng, depth, width, scaling)
    g = int(rng.integers(1, 9))
    size = 10.0 ** rng.uniform(-4, 1)
    inputs = Zonotope(rng.normal(size=n), size * rng.normal(size=(n, g)))
    enclosed = net.enclose(inputs)
    a = rng.uniform(-1, 1, (samples, g))
    a[: samples // 2] = np.sign(a[: samples // 2])
    edge = rng.integers(0, g, samples // 4)
    a[np.arange(samples // 4), edge] = rng.uniform(-1, 1, samples // 4)
    out = net(inputs.c + a @ inputs.G.T)
    left = np.abs(out - enclosed.c - a @ enclosed.G[:, :g].T)
    assert np.all(left <= np.abs(enclosed.G[:, g:]).sum(axis=1))
    assert np.all(np.isfinite(enclosed.G))
    return np.ptp(out, axis=0) / np.maximum(2 * enclosed.half_widths, 1e-300)


@pytest.mark.parametrize("scaling", [1.0, 1e3])
def test_some_networks_of_any_shape_hold_their_samples(scaling):
    filled = [held(seed, 1 + seed % 6, 40, scaling, 400) for seed in range(60)]
    assert np.mean([part.max() > 0.2 for part in filled]) > 0.4, "sets are held, not drowned"


@pytest.mark.slow
@pytest.mark.parametrize("scaling", [1.0, 1e3, 1e6])
@pytest.mark.parametrize("depth", range(1, 7))
def test_many_networks_up_to_256_wide_hold_their_samples(depth, scaling):
    for seed in range(fewer(120, 20)):
        held(1000 * depth + seed, depth, 256, scaling, 3000)


# -- the exact range of small networks ------------------------------------------------------------------


def cut(polygon, row, offset):
    """The part of a convex polygon (k, 2) where ``row x + offset >= 0``."""
    at = polygon @ row + offset
    out = []
    for i, (here, value) in enumerate(zip(polygon, at, strict=True)):
        after, other = polygon[(i + 1) % len(polygon)], at[(i + 1) % len(polygon)]
        if value >= 0:
            out.append(here)
        if value * other < 0:
            out.append(here + (after - here) * value / (value - other))
    return np.array(out).reshape(-1, 2)


def pieces(net, box):
    """All polygons of inputs on which a ReLU network of two inputs is affine, and its map (W, b) there."""
    parts = [(np.asarray(box), np.eye(2), np.zeros(2))]
    for layer in net.layers:
        if isinstance(layer, Affine):
            parts = [(p, layer.W @ W, layer.W @ b + layer.b) for p, W, b in parts]
            continue
        for unit in range(len(parts[0][2])):
            split = []
            for p, W, b in parts:
                for sign in (1, -1):
                    part = cut(p, sign * W[unit], sign * b[unit])
                    if len(part) >= 3:
                        W_, b_ = W.copy(), b.copy()
                        W_[unit], b_[unit] = (
                            (W[unit], b[unit]) if sign > 0 else (layer.low * W[unit], layer.low * b[unit])
                        )
                        split.append((part, W_, b_))
            parts = split
    return parts


def exact(net, box):
    """Exact least and largest outputs over a polygon of inputs, (2, outputs)."""
    ends = np.vstack([p @ W.T + b for p, W, b in pieces(net, box)])
    return np.array([ends.min(axis=0), ends.max(axis=0)])


def small(seed, depth, width, low=0.0):
    rng = np.random.default_rng(seed)
    sizes, layers = [2, *[width] * depth, 1], []
    for before, after in zip(sizes, sizes[1:], strict=False):
        layers += [
            Affine(rng.normal(size=(after, before)) / np.sqrt(before), 0.5 * rng.normal(size=after)),
            Activation("relu", low),
        ]
    return Network(tuple(layers[:-1])), rng.normal(size=2)


CORNERS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def wider(seed, depth, width, size, low=0.0):
    """By which share the enclosed range is wider than the exact one; checks that it holds it."""
    net, centre = small(seed, depth, width, low)
    least, largest = exact(net, centre + size * CORNERS)
    enclosed = net.enclose(Zonotope.box(centre, np.full(2, size)))
    assert np.all(enclosed.c - enclosed.half_widths <= least + 1e-12)
    assert np.all(enclosed.c + enclosed.half_widths >= largest - 1e-12)
    return float(np.max(2 * enclosed.half_widths / np.maximum(largest - least, 1e-9)) - 1)


def test_pieces_cover_the_box_and_agree_with_the_network():
    net, centre = small(3, 2, 5)
    rng, area = np.random.default_rng(0), 0.0
    for p, W, b in pieces(net, centre + CORNERS):
        x = rng.dirichlet(np.ones(len(p)), 20) @ p
        assert net(x) == pytest.approx(x @ W.T + b, abs=1e-10)
        following = np.roll(p, -1, axis=0)
        area += abs(float(np.sum(p[:, 0] * following[:, 1] - p[:, 1] * following[:, 0]))) / 2
    assert area == pytest.approx(4.0)


TIGHT = {(1, 0.05): (0.001, 0.10), (2, 0.05): (0.001, 0.35), (3, 0.05): (0.001, 0.35)}
TIGHT |= {(1, 0.2): (0.02, 0.30), (2, 0.2): (0.15, 0.55), (3, 0.2): (0.25, 1.1)}
"""By depth and half-width of the box: the share by which half, and 90 %, of the ranges are at most wider."""


@pytest.mark.parametrize(("depth", "size"), TIGHT)
def test_ranges_of_small_networks_are_within_stated_shares_of_exact_ones(depth, size):
    shares = [wider(seed, depth, 6, size, low=0.1 * (seed % 2)) for seed in range(60)]
    half, ninth = np.percentile(shares, [50, 90])
    assert half <= TIGHT[depth, size][0] and ninth <= TIGHT[depth, size][1]
    assert max(shares) > 0, "and not by looking away"


@pytest.mark.slow
@pytest.mark.parametrize("depth", [1, 2, 3])
def test_ranges_of_many_small_networks_hold_the_exact_ones(depth):
    for seed in range(fewer(400, 100)):
        wider(seed, depth, 3 + seed % 8, 10.0 ** (seed % 5 - 3), low=0.2 * (seed % 3))


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: f"{kind.kind}{kind.low:g}")
def test_a_chain_of_single_units_has_the_range_of_its_ends(kind):
    """Every unit never decreases: the exact range of a chain lies between its ends, and is held."""
    rng = np.random.default_rng(4)
    for _ in range(50):
        layers = []
        for _ in range(int(rng.integers(1, 6))):
            layers += [Affine(rng.normal(size=(1, 1)) * 10 ** rng.uniform(-2, 2), rng.normal(size=1)), kind]
        net, ends = Network(tuple(layers)), np.sort(rng.normal(size=2))
        enclosed = net.enclose(Zonotope([ends.mean()], [[np.ptp(ends) / 2]]))
        exact_ends = np.sort(net(ends[:, None])[:, 0])
        assert enclosed.c[0] - enclosed.half_widths[0] <= exact_ends[0] + 1e-12
        assert enclosed.c[0] + enclosed.half_widths[0] >= exact_ends[1] - 1e-12
