"""Values of the constraints themselves, by which flights are judged: independent of the filters' formulas."""

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from ...model.system import Array
from ..inspection import Inspection
from .constraint import KINDS, PASSIVE
from .table import ConstraintTable, Index


@lru_cache(maxsize=64)
def _table(q: Inspection) -> tuple[ConstraintTable, dict[str, Index]]:
    """Return all constraints but those on free flights, and the rows of each, (r, N) or (r, P)."""
    table = ConstraintTable(q, PASSIVE.values())
    labels = np.array([one.label for one in table.constraints])
    pair = {name: kind.pair for name, kind in KINDS.items() if name not in PASSIVE}
    pair |= {one.label: one.pair for one in q.constraints}
    size = {True: len(q.pairs), False: q.deputies}
    return table, {
        name: np.flatnonzero(labels == name).reshape(-1 if size[both] else 1, size[both])
        for name, both in pair.items()
    }


def allowable(inspection: Inspection, x: Array, sun: ArrayLike) -> dict[str, Array]:
    """Values of the constraints at states of shape (..., N, 6) and sun angles of shape (...) [rad].

    Returns
    -------
    dict of str to ndarray
        phi1 to phi6, phi9 to phi11 as the paper defines them (eqs. 12 to 19, 23, 24), then one's own, each
        of shape (..., N), or (..., P) for those of the P pairs. phi5 is the smaller of its values for
        (i, j) and (j, i). Without phi7 and phi8 (passively safe manoeuvres), which are h7 and h8.
    """
    table, rows = _table(inspection)
    states, sun = table.stack(x), np.asarray(sun, dtype=float)[..., None]
    parts = [group.barrier.value(states[..., group.at, :], sun) for group in table.groups]
    values = np.concatenate(parts, axis=-1)
    return {label: values[..., at].min(axis=-2) for label, at in rows.items()}
