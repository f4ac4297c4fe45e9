"""Explicit active set invariance filters (eq. 5): centralized, and decentralized in three ways.

A batch holds R independent runs; a single call is a batch of one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import ScenarioError
from ..system import Array
from .families import Families, Rows
from .projection import DESIRED, FILTERED, SHORT, project, solve

Sharing = Literal["coasting", "half", "consensus"]
SHARINGS: tuple[Sharing, ...] = ("coasting", "half", "consensus")


@dataclass(frozen=True, eq=False)
class Filtered:
    """Inputs of a batch.

    Attributes
    ----------
    u : ndarray, shape (R, N, 3)
        Filtered inputs [N]; nan where the program failed.
    status : ndarray of int, shape (R, N)
        See `polaris.asif.projection`.
    rows : Rows
        The barrier conditions.
    """

    u: Array
    status: NDArray[np.int8]
    rows: Rows


class Centralized:
    """One filter that knows the states and sets the inputs of all deputies.

    Parameters
    ----------
    families : Families
    """

    def __init__(self, families: Families) -> None:
        self.families = families
        N, first, second = families.inspection.deputies, families.first, families.second
        M = len(first)
        self._spread = np.zeros((M, N))
        self._spread[np.arange(M), first] = 1.0
        pair = second >= 0
        self._spread[np.flatnonzero(pair), second[pair]] = -1.0

    def batch(self, x: Array, sun: Array, desired: Array) -> Filtered:
        """Filter inputs of shape (R, N, 3) at states (R, N, 6) and sun angles (R,) [rad]."""
        rows = self.families(x, sun)
        u, status = self.project(rows, desired)
        return Filtered(u, status, rows)

    def project(self, rows: Rows, desired: Array) -> tuple[Array, NDArray[np.int8]]:
        """Nearest inputs that satisfy all rows, shapes (R, N, 3) and (R, N)."""
        limit = self.families.inspection.thrust_max
        R, N = desired.shape[:2]
        u = np.clip(desired, -limit, limit)
        kept = (u == desired).all(axis=2)
        status = np.where(kept, DESIRED, FILTERED).astype(np.int8)
        given = np.einsum("rnv,mn->rmv", u, self._spread)
        broken = np.einsum("rmv,rmv->rm", rows.G, given) < rows.bound
        for r in np.flatnonzero(broken.any(axis=1)):
            G, bound = rows.G[r], rows.bound[r]
            reach = limit * np.abs(G).sum(axis=1) * np.abs(self._spread).sum(axis=1)
            needed = np.flatnonzero(bound > -reach)
            spread = self._spread[needed]
            length = np.sqrt(np.einsum("mv,mv,mn->m", G[needed], G[needed], spread * spread))
            scale = 1 / np.maximum(length, 1e-300)
            wide = (spread[:, :, None] * (G[needed] * scale[:, None])[:, None, :]).reshape(len(needed), 3 * N)
            found, how = solve(wide, bound[needed] * scale, desired[r].ravel(), limit)
            u[r] = found.reshape(N, 3)
            status[r] = (
                how if how != FILTERED else np.where((u[r] == desired[r]).all(axis=1), DESIRED, FILTERED)
            )
        return u, status


class Decentralized:
    """A filter per deputy: it knows all states, but not what the others will do.

    Parameters
    ----------
    families : Families
    sharing : {"coasting", "half", "consensus"}
        Who answers for a condition on a pair. ``coasting``, the paper's: each deputy alone, as if the
        other did not thrust. ``half``: each for half of it. ``consensus``: each for its part of the
        solution of the centralized program for no thrust, which every deputy can compute from the states
        all of them know, and for half of what that leaves to spare. The shares of ``half`` and
        ``consensus`` add up to the whole condition, whatever the deputies desire; those of ``consensus``
        can be met whenever the centralized program can.
    """

    def __init__(self, families: Families, sharing: Sharing = "coasting") -> None:
        if sharing not in SHARINGS:
            raise ScenarioError("sharing", sharing, f"must be one of {', '.join(SHARINGS)}")
        self.families, self.sharing = families, sharing
        self._central = Centralized(families) if sharing == "consensus" else None
        N, first, second = families.inspection.deputies, families.first, families.second
        mine = [np.flatnonzero((first == i) | (second == i)) for i in range(N)]
        self._mine = np.array(mine)
        self._sign = np.where(second[self._mine] == np.arange(N)[:, None], -1.0, 1.0)
        self._pair = second >= 0
        self._second = np.where(self._pair, second, 0)

    def batch(self, x: Array, sun: Array, desired: Array) -> Filtered:
        """Filter inputs of shape (R, N, 3) at states (R, N, 6) and sun angles (R,) [rad]."""
        rows = self.families(x, sun)
        R, N = desired.shape[:2]
        limit = self.families.inspection.thrust_max
        share, failed = self._shares(rows)
        u = np.clip(desired, -limit, limit)
        status = np.where((u == desired).all(axis=2), DESIRED, FILTERED).astype(np.int8)
        first = np.einsum("rmv,rmv->rm", rows.G, u[:, self.families.first]) < share[0]
        broken = first
        if self._pair.any():
            second = np.einsum("rmv,rmv->rm", rows.G, u[:, self._second]) > -share[1]
            broken = np.where(self._sign > 0, first[:, self._mine], second[:, self._mine])
        else:
            broken = first[:, self._mine]
        run, who = np.nonzero(broken.any(axis=2))
        if len(run):
            mine, sign = self._mine[who], self._sign[who]
            G = rows.G[run[:, None], mine] * sign[..., None]
            bound = np.where(sign > 0, share[0][run[:, None], mine], share[1][run[:, None], mine])
            found = project(G, bound, desired[run, who], limit)
            u[run, who], status[run, who] = found.u, found.status
        if failed is not None:
            status = np.where(failed[:, None], np.maximum(status, SHORT), status)
        return Filtered(u, status, rows)

    def _shares(self, rows: Rows) -> tuple[tuple[Array, Array], NDArray[np.bool_] | None]:
        """Bounds for the first and for the second deputy of each row, shapes (R, M)."""
        bound = rows.bound
        if self.sharing == "coasting":
            return (bound, bound), None
        if self.sharing == "half":
            half = np.where(self._pair, bound / 2, bound)
            return (half, half), None
        assert self._central is not None
        agreed, status = self._central.project(rows, np.zeros((*bound.shape[:1], len(self._mine), 3)))
        first = np.einsum("rmv,rmv->rm", rows.G, agreed[:, self.families.first])
        second = -np.einsum("rmv,rmv->rm", rows.G, agreed[:, self._second])
        spare = np.maximum(first + second - bound, 0.0) / 2
        return (np.where(self._pair, first - spare, bound), second - spare), (status >= SHORT).any(axis=1)
