"""Networks: enclosures against sampled truth, bands against dense grids, loops against flights."""

from dataclasses import replace
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import expm

from reach.networks.layers import Activation, Affine, Diagonal
from reach.networks.loop import NetworkLoop
from reach.networks.network import Network
from reach.networks.precision import FORMATS, Rounding
from reach.numerics.errors import ReachError, Unresolved
from reach.numerics.linear import discretize
from reach.sets.zonotope import Zonotope
from tests.reach.single_precision import ORDERS, evaluated
from tests.sizes import fewer

ACTIVATIONS = [*(Activation("relu", slope) for slope in (0.0, 0.1, 3.0)), Activation("tanh")]
ACTIVATIONS += [Activation("sigmoid"), Activation("clip", -0.5, 1.0)]


def random_network(rng, inputs, widths, outputs, activation, scale=1.0):
    sizes = [inputs, *widths, outputs]
    layers = []
    for before, after in pairwise(sizes):
        W = rng.normal(size=(after, before)) * scale / np.sqrt(before)
        layers += [Affine(W, rng.normal(size=after)), activation]
    return Network(tuple(layers[:-1]))


@pytest.mark.parametrize("activation", ACTIVATIONS, ids=str)
def test_bands_hold_on_a_grid_and_touch(activation):
    rng = np.random.default_rng(1)
    for size in (1e-8, 1e-3, 1.0, 30.0, 1e5):
        ends = np.sort(rng.normal(size=(400, 2)) * size, axis=1)
        lo, hi = ends[:, 0], ends[:, 1]
        slope, offset, radius = activation.band(lo, hi)
        y = lo + (hi - lo) * np.linspace(0, 1, 2001)[:, None]
        errors = np.abs(activation(y) - slope * y - offset)
        assert np.all(errors <= radius)
        # What rounding is booked apart, the band is the least of its slope.
        slack = 64 * np.finfo(float).eps * (np.abs(ends).max(axis=1) + 1)
        assert np.all(errors.max(axis=0) >= 0.999 * radius - slack - 1e-5 * (hi - lo) * (radius > 0))


def drawn(rng, depth, width, scaling):
    """A random network: activations mixed, rows scaled by up to `scaling`, units dead or doubled."""
    sizes = [int(rng.integers(1, 7)), *(int(rng.integers(1, width + 1)) for _ in range(depth)), 2]
    layers = []
    for before, after in pairwise(sizes):
        W = rng.normal(size=(after, before)) / np.sqrt(before)
        W *= scaling ** rng.uniform(-1, 1, (after, 1))
        b, fate = rng.normal(size=after) * scaling ** rng.uniform(-1, 1, after), rng.random(after)
        W[fate < 0.1] = 0.0  # reads nothing
        b[(fate >= 0.1) & (fate < 0.2)] -= 1e3 * scaling  # never answers, or is saturated
        if after > 1 and fate[0] > 0.5:
            W[1], b[1] = -W[0], -b[0]
        layers += [Affine(W, b), ACTIVATIONS[int(rng.integers(len(ACTIVATIONS)))]]
    return Network(tuple(layers[:-1]))


def filled(seed, depth, width, scaling):
    """Check one enclosure against inner points, corners and points on edges; the share that they fill."""
    rng = np.random.default_rng(seed)
    net, g = drawn(rng, depth, width, scaling), int(rng.integers(1, 9))
    inputs = Zonotope(
        rng.normal(size=net.inputs), 10.0 ** rng.uniform(-4, 1) * rng.normal(size=(net.inputs, g))
    )
    enclosed, a = net.enclose(inputs), rng.uniform(-1, 1, (400, g))
    a[:200] = np.sign(a[:200])
    a[np.arange(100), rng.integers(0, g, 100)] = rng.uniform(-1, 1, 100)
    out = net(inputs.c + a @ inputs.G.T)
    residual = np.abs(out - enclosed.c - a @ enclosed.G[:, :g].T)
    assert np.all(residual <= np.abs(enclosed.G[:, g:]).sum(axis=1)) and np.all(np.isfinite(enclosed.G))
    return np.max(np.ptp(out, axis=0) / np.maximum(2 * enclosed.half_widths, 1e-300))


@pytest.mark.parametrize("scaling", [1.0, 1e3, 1e8])
def test_outputs_stay_tied_to_their_inputs(scaling):
    shares = [filled(seed, 1 + seed % 6, 40, scaling) for seed in range(60)]
    assert scaling > 1e3 or np.mean(np.array(shares) > 0.2) > 0.4, "sets are held, not drowned"


@pytest.mark.slow
@pytest.mark.parametrize("scaling", [1.0, 1e3, 1e6])
def test_outputs_of_networks_up_to_256_wide_stay_tied_to_their_inputs(scaling):
    for seed in range(fewer(720, 60)):
        filled(1000 + seed, 1 + seed % 6, 256, scaling)


@pytest.mark.parametrize("kind", ACTIVATIONS, ids=str)
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


def test_small_sets_cost_their_square():
    """The radii of the bands shrink with the square of the set where the activation is smooth."""
    net = random_network(np.random.default_rng(5), 3, [16, 16], 2, Activation("tanh"))
    sets = (Zonotope.box(np.full(3, 0.2), np.full(3, size)) for size in (1e-2, 1e-3))
    rest = [np.abs(net.enclose(inputs).G[:, 3:]).sum() for inputs in sets]
    assert 80 < rest[0] / rest[1] < 120


def a_loop(seed, activation=ACTIVATIONS[2]):
    """A double integrator under a random network around a stabilising law, clipped."""
    rng = np.random.default_rng(seed)
    net = random_network(rng, 2, [12], 1, activation, 0.3)
    # relu(y) - relu(-y) = y: the law is carried past the random part.
    first, last, K = net.layers[0], net.layers[2], np.array([[1.0, 1.7]])
    body = Affine(np.vstack([first.W, K, -K]), np.r_[first.b, 0, 0])
    out = Affine(np.c_[0.05 * last.W, [[-1.0, 1.0]]], 0.05 * last.b)
    layers = (body, Activation("relu"), out, Activation("clip", -1.0, 1.0))
    push = np.array([[0.0], [1.0]])
    return NetworkLoop([[0.0, 1.0], [0.0, 0.0]], push, push, 0.02, 0.1, Network(layers), np.eye(2))


@pytest.mark.parametrize("seed", range(6))
def test_flights_stay_in_the_tube_between_samples_too(seed):
    loop, rng = a_loop(seed), np.random.default_rng(seed)
    start = Zonotope.box(rng.normal(size=2), [0.1, 0.1])
    tube = loop.tube(start, 80)
    x = start.sample(rng, 300)
    w = 0.02 * np.sign(rng.normal(size=(300, 1)))
    Ah, Bh = discretize(loop.A, np.hstack([loop.B, loop.D]), loop.h / 4)
    rows = np.vstack([np.eye(2), -np.eye(2), rng.normal(size=(6, 2))])
    bounds, nodes, reached = tube.support(rows), tube.nodes.support(rows), -np.inf
    for k in range(80):
        u = loop.network(x)
        w = np.where(rng.uniform(size=w.shape) < 0.1, -w, w)
        for _ in range(4):
            assert np.all(x @ rows.T <= bounds[k] + 1e-12)
            x = x @ Ah.T + np.hstack([u, w]) @ Bh.T
        assert np.all(x @ rows.T <= nodes[k + 1] + 1e-12)
        reached = max(reached, float(np.max(x @ rows.T / nodes[k + 1])))
    # Contracting: the loop's tube ends where the disturbance holds it, not where it began, or beyond.
    assert np.all(tube.nodes[-1].half_widths < 0.35) and reached > 0.5


def test_periods_agree_with_matrix_exponentials():
    loop = a_loop(0)
    x = np.array([0.3, -0.2])
    after, intersample, command = loop.step(Zonotope.point(x), v=np.array([0.4]))
    u = loop.network(x) + 0.4
    joined = np.block([[loop.A, (loop.B @ u)[:, None]], [np.zeros((1, 3))]])
    exact = expm(joined * loop.h) @ np.r_[x, 1.0]
    assert np.abs(after.c - exact[:2]).max() < 1e-12 and command.c + 0.4 == pytest.approx(u)
    assert np.all(intersample >= loop.flow.period_box)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Affine(np.ones((2, 3)), np.ones(3)), "biases"),
        (lambda: Affine(np.full((2, 2), np.nan), np.ones(2)), "finite"),
        (lambda: Activation("softplus"), "must be one of"),
        (lambda: Activation("relu", -0.5), "leaky"),
        (lambda: Activation("clip", 1.0, 0.0), "low <= high"),
        (lambda: Network((Activation("relu"),)), "at least one"),
        (lambda: Network([Affine(np.ones((k, 3)), np.ones(k)) for k in (2, 1)]), "followed by"),
        (lambda: a_loop(0).network.enclose(Zonotope.point(np.zeros(3))), "dimension 3"),
        (lambda: a_loop(0).network.enclose(Zonotope.point([1e308, 1e308])), "beyond floating point"),
    ],
)
def test_what_is_no_network_is_told(make, words):
    with pytest.raises(ReachError, match=words):
        make()


def with_precision(net, precision):
    return Network(net.layers, precision)


def escapes(net, hull, x, order, dtype=np.float32):
    """By how much a floating-point evaluation leaves the enclosure of its inputs."""
    out = evaluated(net, x, dtype, order)
    return float(np.max(np.abs(out - hull.c) - np.abs(hull.G).sum(axis=1)))


@pytest.mark.parametrize("order", ORDERS)
def test_single_precision_stays_in_the_hull_that_books_it_and_leaves_the_one_that_does_not(order):
    rng, escaped = np.random.default_rng(5), 0
    for k in range(60):
        activation = ACTIVATIONS[k % len(ACTIVATIONS)]
        net = random_network(rng, 4, [int(rng.integers(2, 65))] * int(rng.integers(1, 4)), 2, activation, 1.5)
        if k % 3 == 0:  # gains that nearly cancel
            big = Diagonal(np.full(2, 1e3), -1e3 * net(np.ones(4)))
            net = Network((*net.layers, big))
        x = np.ones(4) + 1e-3 * rng.normal(size=4)
        point = Zonotope.point(x)
        enclosure = with_precision(net, "float32").enclose(point)
        assert escapes(net, enclosure, x, order) <= 0
        escaped += escapes(net, net.enclose(point), x, order) > 0
        size = np.abs(net.enclose(point).c) + (1e3 if k % 3 == 0 else 1)
        assert np.all(enclosure.half_widths <= 2e-3 * size)
    assert escaped > 50


@pytest.mark.parametrize(
    "layers",
    [
        (Affine(np.full((3, 40), 3e-20), np.zeros(3)), Affine(np.full((1, 3), 1e18), np.zeros(1))),
        (Affine(np.ones((1, 4096)), np.zeros(1)),),
    ],
)
def test_products_near_zero_and_long_sums_are_booked_in_any_order(layers):
    x = np.full(layers[0].shape[1], 3e-19 if len(layers) > 1 else 0.1)
    hull = Network(layers, "float32").enclose(Zonotope.point(x))
    assert all(escapes(Network(layers), hull, x, order) <= 0 for order in ORDERS)
    assert escapes(Network(layers), Network(layers).enclose(Zonotope.point(x)), x, "flushed") > 0


@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_rounding_of_double_precision_is_that_of_single_precision_in_its_unit(activation):
    net = random_network(np.random.default_rng(8), 3, [6, 6], 2, activation, 1.5)
    real, single, double = (
        with_precision(net, precision).enclose(Zonotope.point(np.ones(3))).half_widths
        for precision in ("real", "float32", "float64")
    )
    assert (double - real) / (single - real) == pytest.approx(2.0**-29, rel=0.01)


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_inputs_are_read_within_their_rounding(precision):
    """A number, its scale and their product are each rounded: up to three units, and some nearly that."""
    rng, ratios = np.random.default_rng(4), []
    unit = float(np.finfo(FORMATS[precision]).eps) / 2
    for _ in range(2000):  # just above powers of two, a unit is most of a number
        number, scale = (
            Fraction(1 + 10 ** rng.uniform(-6, -2)) + Fraction(unit * rng.uniform(0.8, 1)) for _ in "xs"
        )
        rounded = [np.array(float(exact)).astype(FORMATS[precision]) for exact in (number, scale)]
        error = abs(Fraction(float(rounded[0] * rounded[1])) - number * scale)
        bound = Rounding.from_precision(precision).read(np.array([float(number * scale)]))
        ratios.append(float(error / Fraction(float(bound[0]))))
    assert 0.6 < max(ratios) <= 1


def test_sums_that_may_overflow_and_unknown_precisions_are_refused():
    layers = (Affine(np.full((4, 4), 1e20), np.zeros(4)), Affine(np.full((1, 4), 1e20), np.zeros(1)))
    inputs = Zonotope.box(np.zeros(4), np.ones(4))
    Network(layers).enclose(inputs)
    with pytest.raises(Unresolved, match="beyond its floating-point format"):
        Network(layers, "float32").enclose(inputs)
    with pytest.raises(ReachError, match="precision must be one of real, float32, float64, got 'half'"):
        Network(layers, "half")


ZERO = np.zeros(1)
INFINITE = {
    "a weight": (1e-3, Affine([[1e39]], ZERO), Affine([[1e-39]], ZERO)),
    "a scale": (1e-3, Diagonal([1e39], ZERO), Affine([[1e-39]], ZERO)),
    "an input": (1e39, Affine([[1e-39]], ZERO)),
    "an activation": (-1e10, Activation("relu", 1e30), Affine([[1e-30]], ZERO)),
    "a limit": (0.0, Activation("clip", 1e39, 1e40), Affine([[1e-39]], ZERO)),
}
"""An input and layers with a number that single precision does not have; what comes out is near 1."""


@pytest.mark.parametrize("name", INFINITE)
def test_numbers_that_round_to_infinity_are_refused(name):
    x, *layers = INFINITE[name]
    inputs = Zonotope.point([x])
    assert np.abs(Network(layers, "float64").enclose(inputs).c) < 1e11
    with np.errstate(all="ignore"):
        assert not np.isfinite(Network(layers, "float32")([x]))
    with pytest.raises(Unresolved, match="beyond its floating-point format"):
        Network(layers, "float32").enclose(inputs)


def test_a_loop_books_the_precision_of_its_network():
    loop = a_loop(0)
    states = Zonotope.box(np.zeros(2), [0.1, 0.1])
    rounded = replace(loop, network=with_precision(loop.network, "float32"))
    wider = rounded.command(states).half_widths - loop.command(states).half_widths
    assert np.all(wider > 1e-8)


def test_steepest_bounds_differences_of_outputs():
    rng = np.random.default_rng(9)
    for k in range(12):
        net = with_precision(random_network(rng, 4, [16, 16], 2, ACTIVATIONS[k % 6]), "float32")
        rounded, exact = net.steepest(np.eye(4)), Network(net.layers).steepest(np.eye(4))
        assert np.all(rounded > exact)
        x, z = rng.normal(size=(200, 4)), 0.5 * rng.normal(size=(200, 4))
        changes = np.abs(Network(net.layers)(x + z) - Network(net.layers)(x))
        assert np.all(changes <= np.abs(z) @ exact.T + 1e-12)
