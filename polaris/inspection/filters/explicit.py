"""Explicit active set invariance filters (eq. 5): centralized, and decentralized in three ways.

A batch holds R independent runs; a single call is a batch of one.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...model.checks import of_kind, one_of
from ...model.compiled import loops, plain
from ...model.errors import ScenarioError
from ...model.system import Array
from ...rta.projection import DESIRED, FAILED, FILTERED, SHORT, project, project_coupled
from ..constraints.families import BarrierRows, Families
from ..vectors import dot

CENTRALIZED = "centralized"
SHARINGS = ("coasting", "half", "consensus")
Statuses = NDArray[np.int8]

TRIES = 6  # programs for which the curvature is bounded by the thrust that the one before chose
MET = 1e-9  # by how much a condition may be missed [units of h per s]: what the solver leaves

LOOPS, LEFT = "polaris.rta.nearest", -1
"""Compiled programs, and the status of one that they leave to the solver."""

AGREED = 1e-9
"""Largest miss of a deputy's part of an agreed solution that violates a row [units of h per s]."""


@dataclass(frozen=True, eq=False)
class Filtered:
    """Inputs of a batch.

    Attributes
    ----------
    u : ndarray, shape (R, N, 3)
        Filtered inputs [N]; nan where the program failed.
    status : ndarray of int, shape (R, N)
        See `polaris.rta.projection`.
    rows : BarrierRows
        The barrier conditions.
    """

    u: Array
    status: Statuses
    rows: BarrierRows


class Centralized:
    """One filter that knows the states and sets the inputs of all deputies.

    Parameters
    ----------
    families : Families
    """

    def __init__(self, families: Families) -> None:
        of_kind("families", families, Families)
        self.families, self.loops = families, loops(LOOPS)

    def batch(self, x: Array, sun: Array, desired: Array) -> Filtered:
        """Filter inputs of shape (R, N, 3) at states (R, N, 6) and sun angles (R,) [rad]."""
        shaped_as(x, desired)
        rows = self.families(x, sun)
        u, status = self.project(rows, desired)
        if self.families.sampled is not None and status.max() >= SHORT:
            runs = np.flatnonzero(status.max(axis=1) >= SHORT)
            self._tighten(Filtered(u, status, rows), runs, x, sun, desired)
        return Filtered(u, status, rows)

    def _tighten(self, batch: Filtered, runs: NDArray[np.intp], x: Array, sun: Array, desired: Array) -> None:
        """Solve some runs again, curvature bounded by the thrust chosen, until answers meet their rows."""
        families, u = self.families, np.zeros_like(desired[runs])
        bound: Array = np.full(batch.rows.bound[runs].shape, -np.inf)
        for _ in range(TRIES):
            rows = families(x[runs], sun[runs], u)
            bound = np.maximum(bound, rows.bound)
            u, status = self.project(BarrierRows(rows.h, rows.G, bound), desired[runs])
            solved = status.max(axis=1) < SHORT
            if not solved.any():
                return
            actual = families(x[runs], sun[runs], np.where(np.isfinite(u), u, 0.0))
            satisfied = np.einsum("rmv,rmv->rm", actual.G, families.relative(u)) >= actual.bound - MET
            good = solved & satisfied.all(axis=1)
            for target, update in ((batch.u, u), (batch.status, status), (batch.rows.bound, bound)):
                target[runs[good]] = update[good]
            pending = solved & ~good
            runs, bound, u = runs[pending], bound[pending], u[pending]
            if not len(runs):
                return

    def project(self, rows: BarrierRows, desired: Array) -> tuple[Array, Statuses]:
        """Inputs nearest to the clipped ones that satisfy all rows, shapes (R, N, 3) and (R, N)."""
        families, limit = self.families, self.families.inspection.thrust_max
        deputies = families.first, families.second
        if self.loops:
            G, bound, desired = plain(rows.G), plain(rows.bound), plain(desired)
            u, status, unsolved = self.loops.coupled(G, bound, *deputies, desired, limit)
            if not unsolved:
                return u, status
            runs = np.flatnonzero(status[:, 0] == LEFT)
        else:
            u = families.clip_inputs(desired)
            status = _unchanged(u, desired)
            broken = ~(dot(rows.G, families.relative(u)) >= rows.bound)  # nan: not met
            runs = np.flatnonzero(broken.any(axis=1))
        if len(runs):
            G, bound, rank = rows.G[runs], rows.bound[runs], families.rank(rows.h[runs])
            solution = project_coupled(G, bound, u[runs], limit, *deputies, rank)
            u[runs] = solution.u
            worse = solution.status[:, None]
            status[runs] = np.where(worse > FILTERED, worse, _unchanged(solution.u, desired[runs]))
        return u, status


class Decentralized:
    """A filter per deputy: it knows all states, but not the others' inputs.

    Parameters
    ----------
    families : Families
    sharing : {"coasting", "half", "consensus"}
        Shares of a condition on a pair. ``coasting``, the paper's: each deputy alone, as if the
        other did not thrust. ``half``: each for half of it. ``consensus``: each for its part of the
        solution of the centralized program for no thrust, which every deputy can compute from the states
        all of them know, and for half of what that leaves to spare. The shares of ``half`` and
        ``consensus`` add up to the whole condition, whatever the deputies desire; those of ``consensus``
        can be met whenever the centralized program can.
    """

    def __init__(self, families: Families, sharing: str = "coasting") -> None:
        of_kind("families", families, Families)
        one_of("sharing", sharing, SHARINGS)
        self.families, self.sharing, self.loops = families, sharing, loops(LOOPS)
        N, first, second = families.inspection.deputies, families.first, families.second
        self._mine = np.array([np.flatnonzero((first == i) | (second == i)) for i in range(N)])
        self._as_second = second[self._mine] == np.arange(N)[:, None]
        self._sign = np.where(self._as_second, -1.0, 1.0)
        self._pair = second >= 0

    def batch(self, x: Array, sun: Array, desired: Array) -> Filtered:
        """Filter inputs of shape (R, N, 3) at states (R, N, 6) and sun angles (R,) [rad]."""
        shaped_as(x, desired)
        rows, limit = self.families(x, sun), self.families.inspection.thrust_max
        bounds, agreed = self._shares(rows, desired.shape[1])
        if self.loops:
            arguments = self._mine, self._sign, plain(desired)
            u, status, unsolved = self.loops.alone(rows.G, bounds, *arguments, limit)
            if agreed is None and not unsolved:
                return Filtered(u, status, rows)
            run, deputy = np.nonzero(status == LEFT)
        else:
            u = self.families.clip_inputs(desired)
            status = _unchanged(u, desired)
        # Row by row, as the deputies see it: their rows, signs and bounds, shapes (R, N, m, ...).
        bound = np.where(self._as_second, bounds[-1][:, self._mine], bounds[0][:, self._mine])
        if not self.loops:
            signed = rows.G[:, self._mine] * self._sign[..., None]
            products = np.einsum("rnmv,rnv->rnm", signed, u)
            run, deputy = np.nonzero((~(products >= bound)).any(axis=2))  # nan: not met
        if len(run):
            signed = rows.G[run[:, None], self._mine[deputy]] * self._sign[deputy][..., None]
            rank = self.families.rank(rows.h)[:, self._mine][run, deputy]
            solution = project(signed, bound[run, deputy], u[run, deputy], limit, rank)
            u[run, deputy] = solution.u  # clipping alone counts as filtering, too
            status[run, deputy] = np.maximum(solution.status, _unchanged(solution.u, desired[run, deputy]))
        if agreed is not None:
            status = np.maximum(status, np.where(agreed >= SHORT, agreed, DESIRED)[:, None]).astype(np.int8)
        u[status == FAILED] = np.nan
        return Filtered(u, status, rows)

    def _shares(self, rows: BarrierRows, deputies: int) -> tuple[Array, Statuses | None]:
        """Bounds for a row's first and second deputy, (2, R, M), or both; the status of the agreement."""
        bound = rows.bound
        if self.sharing == "coasting":
            return bound[None], None
        if self.sharing == "half":
            half = np.where(self._pair, bound / 2, bound)
            return np.stack([half, half]), None
        agreed, status = Centralized(self.families).project(rows, np.zeros((len(bound), deputies, 3)))
        agreed = np.where(np.isfinite(agreed), agreed, 0.0)  # where it failed, the status says so
        first = np.einsum("rmv,rmv->rm", rows.G, agreed[:, self.families.first])
        second = np.asarray(-np.einsum("rmv,rmv->rm", rows.G, agreed[:, self.families.second]))
        status = status.max(axis=1)
        spare = np.maximum(first + second - bound, 0.0) / 2
        # Where the agreed solution itself falls short of a row, nobody is asked for more than its part of it.
        short = (status == SHORT)[:, None]
        alone = np.where(short, np.minimum(bound, first - AGREED), bound)
        spare = spare + np.where(short, AGREED, 0.0)
        return np.stack([np.where(self._pair, first - spare, alone), second - spare]), status


def make_filter(families: Families, sharing: str) -> Centralized | Decentralized:
    """The filter ``centralized``, or the decentralized one that shares as its name says, if there is one."""
    return Centralized(families) if sharing == CENTRALIZED else Decentralized(families, sharing)


def shaped_as(x: Array, desired: Array) -> None:
    """Refuse inputs that are not those of states (R, N, 6)."""
    if x.ndim != 3 or desired.shape != (*x.shape[:2], 3):
        rule = f"must have shape (R, N, 3) for states of shape (R, N, 6), here {x.shape}"
        raise ScenarioError("desired", desired.shape, rule)


def _unchanged(u: Array, desired: Array) -> Statuses:
    same = (u == desired).all(axis=-1)
    return np.asarray(~same, dtype=np.int8)  # DESIRED is 0, FILTERED is 1
