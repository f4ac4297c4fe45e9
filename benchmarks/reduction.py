"""Tightness and speed of each order reduction, on random zonotopes and on those of a tube.

Excess: mean half-width over fixed directions, over that of the original, less one. Loss: the bound
of `reduction_loss` over the half-widths, its mean. Medians over the sets; time is per set of a stack, the
best of five.
"""

import time

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.linalg import expm

from reach.sets.reduction import METHODS, mean_width, reduce, reduction_loss
from reach.sets.zonotope import Zonotope

COUNT = 100


def random_sets(rng, n, g):
    """Independent Gaussian generators."""
    return Zonotope(np.zeros((COUNT, n)), rng.normal(size=(COUNT, n, g)))


def tube_sets(rng, n, g):
    """Sums of images of one small box under the powers of a stable matrix, one matrix per set."""
    sets = []
    for _ in range(COUNT):
        A = rng.normal(size=(n, n))
        A -= (np.linalg.eigvals(A).real.max() + 0.1) * np.eye(n)
        step, box, blocks = expm(0.2 * A), np.diag(rng.uniform(0.1, 1, n)), []
        for _ in range(-(-g // n)):
            blocks.append(box)
            box = step @ box
        sets.append(Zonotope(np.zeros(n), np.hstack(blocks)[:, :g]))
    return Zonotope.stack(sets)


def main():
    table = Table(title="Order reduction")
    for name in ("sets", "n", "generators", "order", "method", "excess %", "loss %", "µs per set"):
        table.add_column(name, justify="left" if name in ("sets", "method") else "right")
    rng = np.random.default_rng(0)
    for kind, build in (("random", random_sets), ("tube", tube_sets)):
        for n, g in ((2, 20), (4, 40), (6, 60)):
            stack = build(rng, n, g)
            size = stack.half_widths[..., None]
            width = mean_width(stack.G / size)
            for order in (1, 2, 5):
                for method in (*METHODS, "auto"):
                    seconds = np.inf
                    for _ in range(5):
                        start = time.perf_counter()
                        small = reduce(stack, order, method)
                        seconds = min(seconds, time.perf_counter() - start)
                    excess = np.median(mean_width(small.G / size) / width - 1)
                    loss = np.median((reduction_loss(stack, small) / size[..., 0]).mean(axis=-1))
                    row = (kind, n, g, order, method, f"{100 * excess:.1f}", f"{100 * loss:.0f}")
                    table.add_row(*map(str, row), f"{1e6 * seconds / COUNT:.0f}")
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
