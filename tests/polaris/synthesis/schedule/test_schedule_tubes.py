"""The tubes that guard every bundled schedule, against the tubes of `reach` that were attacked by themselves.

A schedule's tubes come from `reach.LinearFlow`: exact at the nodes, enclosed between them, and shaped for a
search that follows thousands of steps. Here every one of them is asked in many directions whether it
contains what `reach.support_tube` shows to be reached, and how much larger it is than that.
"""

import numpy as np
import pytest

from polaris.synthesis.controllers.controllers import AffineController
from polaris.synthesis.tracker.intersample import at_nodes
from reach import Ellipsoid, LinearSystem, Zonotope, support_tube
from reach.numerics.linear import powers
from tests.kept import CHOSEN, printed

WIDER = 1.05
"""Most by which the width of a stored set along an axis may exceed what is attained there."""


def reached(law, start, rows):
    """Supports attained about the law's reference, at the nodes (q+1, r) and within the periods (q, *, r)."""
    flow, q, system = law.flow, law.feedback.nodes_per_cell, law.system
    ball = Ellipsoid.ball(np.zeros(system.D.shape[1]), system.w_max)
    # From one renewal of the input to the next: each period's share along the row carried to its end.
    carried = rows @ powers(flow.phi, q)
    flat, rest = carried[:-1].reshape(-1, system.n), Zonotope.point(np.zeros(system.n))
    tube = support_tube(LinearSystem(flow.A_x, system.D, ball), rest, flow.h, flat, step=flow.h / 16)
    pushed = np.cumsum(tube.attained[-1].reshape(q, -1), axis=0)
    first = np.array([start.support(images) for images in carried])
    nodes = first + np.vstack([np.zeros((1, len(rows))), pushed])
    return nodes, nodes[:-1, None]


@pytest.mark.parametrize(
    ("name", "more"),
    [
        ("static", CHOSEN),
        ("dynamic", CHOSEN),
        *(
            pytest.param(n, "", marks=pytest.mark.slow)
            for n in ("static", "dynamic", "keep_out", "hold_point", "robot")
        ),
    ],
)
def test_every_stored_set_contains_the_exact_one_and_is_hardly_larger(name, more):
    _, schedule = printed(name, *filter(None, [more]))
    rng, wider = np.random.default_rng(0), []
    for k, step in enumerate(schedule.steps):
        law, stored = schedule.controllers[step.mode], step.tube
        if not isinstance(law, AffineController) or stored.slopes is not None:
            continue  # where the input is any, or a command may be clipped, there is no exact set to compare
        n, zeta = law.system.n, law.offset[k]
        size = stored.nodes.half_widths.max(axis=0)
        rows = np.vstack([np.eye(n), -np.eye(n), rng.normal(size=(24, n)) / np.where(size > 0, size, 1.0)])
        nodes, inside = reached(law, stored.nodes[0] - zeta[0], rows)
        shift = zeta @ rows.T
        holds = stored.nodes.support(rows) - shift
        grain = 1e-9 * (np.abs(nodes).max(axis=0) + np.abs(shift).max(axis=0))
        assert np.all(holds >= nodes - grain), f"step {k}, at the nodes"
        assert np.all(stored.end.support(rows) - shift[-1] >= nodes[-1] - grain), f"step {k}, at its end"
        between = np.maximum(holds[1:], holds[:-1]) + stored.intersample @ np.abs(rows).T
        assert np.all(inside <= between[:, None] + grain), f"step {k}, between the nodes"
        widths = [bounds[1:, :n] + bounds[1:, n : 2 * n] for bounds in (holds, nodes)]
        wider.append((widths[0] / widths[1]).max())
    assert len(wider) > len(schedule.steps) / 3
    assert max(wider) <= WIDER, f"up to {max(wider):.4f} times as wide"


def test_a_bow_at_a_node_is_that_of_the_larger_of_its_sides():
    parts = np.array([[[1.0, 5.0], [3.0, 2.0], [2.0, 4.0]]])
    assert at_nodes(parts).tolist() == [[[1.0, 5.0], [3.0, 5.0], [3.0, 4.0], [2.0, 4.0]]]
