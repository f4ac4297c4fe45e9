"""Printed margins: never more than the share of the room that is really left, nor much less."""

import numpy as np
import pytest

from polaris.model.errors import PolarisError
from polaris.simulation.disturbances import adjoint_worst_case
from polaris.simulation.integration import Integrator
from polaris.synthesis.controllers import AffineController, AnyThrust

from .random_scenarios import synthesised

STEPS, NODES = 3, 16
"""Steps under U that are looked at in every scene, and nodes after each, the nearest ones all.

Those where the printed margin says that the limit bites come on top.
"""


def worst_share(schedule, k, substeps):
    """Least share of the room left on any limit where S takes over at the start or the end of step k.

    An upper bound on the true one: of every limit and node the worst disturbance, held over integration
    steps, and the worst start are flown, and what they need is compared with the distance of the reference.
    """
    safety = schedule.safety
    clearance, system, q = safety.clearance, safety.problem.system, safety.clearance.q
    rows, least = np.vstack([clearance.obstacle_rows[0], safety.tracking.gain, -safety.tracking.gain]), np.inf
    path = safety.reference.fine(q)[:, :-1].reshape(-1, system.n)
    for last in (k, k + 1):
        modes = np.append(schedule.modes[:last], np.zeros(clearance.cells - last, dtype=int))
        flight = Integrator(schedule, modes, substeps)
        ahead = np.unique(np.geomspace(1, clearance.cells * q, NODES).astype(int)) - 1
        told = int(schedule.steps[k].margin.time / safety.tracking.flow.h + 0.5) + np.arange(q + 1)
        nodes = np.unique(np.concatenate([last * q + ahead, told]))
        nodes = nodes[(nodes >= max(last * q, 1)) & (nodes < clearance.cells * q)]
        if not len(nodes):
            continue
        which, node = (part.ravel() for part in np.meshgrid(np.arange(len(rows)), nodes, indexing="ij"))
        w, free, adjoint = adjoint_worst_case(flight, rows[which], node * substeps)
        flight.free = free
        x0 = safety.problem.initial_set.support_vector(adjoint)
        states = flight.run(x0, w)[1]
        errors = states[:, nodes] - path[nodes]
        needs = np.einsum("rn,pjn->jrp", rows, errors).max(axis=-1)  # of any run at any node
        for need, at in zip(needs, nodes, strict=True):
            least = min(least, float(np.min(1 - need / rooms(safety, at))))
    return least


def rooms(safety, node):
    """Room of every row at a node, as far as the cell to its right has such a limit."""
    clearance, system, q = safety.clearance, safety.problem.system, safety.clearance.q
    cell, place = divmod(int(node), q)
    normals, index = clearance.obstacle_rows
    found = np.full(len(normals), np.inf)
    x = safety.reference.fine(q)[cell, place]
    for o, unsafe in enumerate(clearance.unsafe):
        facet = clearance.facets[cell, o]
        room = unsafe.normals[facet] @ system.position @ x - unsafe.fine(q)[cell, place, facet]
        found[index[cell, o]] = min(found[index[cell, o]], room)
    u = safety.reference.nu[cell]
    return np.concatenate([found, system.u_max + u, system.u_max - u])


def looked_at(schedule):
    """Some steps under U."""
    flown = np.flatnonzero(schedule.modes > 0)
    return flown[np.unique(np.linspace(0, len(flown) - 1, STEPS).astype(int))] if len(flown) else flown


def linear(schedule, k):
    """Whether nothing can have clipped up to a step, so that the worst case flown is the worst there is."""
    for j, step in enumerate(schedule.steps[: k + 1]):
        law = schedule.controllers[step.mode]
        if isinstance(law, AnyThrust):
            return False
        assert isinstance(law, AffineController)
        if law.clips and law._over_limit(step.flight.nodes - law.offset[j], step.flight.bow, j)[0] > 0:
            return False
    return True


def examined(seeds, folder):
    """(kind, printed, flown, exact) of steps of random scenes."""
    for seed in seeds:
        try:
            _, schedule = synthesised(seed, folder)
        except PolarisError:
            continue
        if schedule.guarantee != "proved":
            continue
        for k in looked_at(schedule):
            yield (
                schedule.safety.recoverable.kind,
                schedule.margins[k],
                worst_share(schedule, k, 2),
                linear(schedule, k),
            )


def judge(found):
    """No margin above what is left; those of polytopes, where the worst case is known, not far below."""
    over = [(printed, flown) for _, printed, flown, _ in found if not printed <= flown + 1e-9]
    assert not over
    short = [flown - printed for kind, printed, flown, exact in found if exact and kind == "polytope"]
    assert np.median(short) < 0.1 and np.quantile(short, 0.9) < 0.5


def test_margins_of_random_scenes(tmp_path):
    found = list(examined((2, 10, 33, 43), tmp_path))
    assert len(found) >= 10 and len({kind for kind, *_ in found}) == 3
    judge(found)


@pytest.mark.slow
def test_margins_of_many_random_scenes(tmp_path):
    found = list(examined(range(100, 200), tmp_path))
    assert len(found) > 150 and len({kind for kind, *_ in found}) == 3
    judge(found)
