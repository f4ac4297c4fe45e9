"""Explicit active set invariance filter for one flight, call by call, that never passes on bad input."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import ScenarioError
from ..system import Array
from .decision import Backup, Decision
from .families import Families, Rows
from .filters import Centralized, Decentralized, Sharing
from .inspection import Inspection
from .projection import DESIRED, FAILED, SHORT
from .sampled import SampledData
from .strengthening import Strengthening

TIGHT = 1e-7
"""A condition counts as active if the input misses equality by less [N]."""


class ActiveSetFilter:
    """Nearest input that keeps every constraint (eq. 5), with defined answers to bad input.

    - A deputy whose state is not finite is taken to be where its last state and thrust lead; after `patience`
      seconds without a state, or before the first, every deputy coasts (h7 and h8 keep coasting clear of
      collisions for T).
    - A missing or not finite desired input is replaced by the backup controller's, which is then filtered.
    - Where no input satisfies all conditions, the one that violates them least is used; should the program
      fail altogether, the backup controller's.

    The desired input is never passed on in any of these cases, and `Decision.fallback` says which it was.

    Parameters
    ----------
    inspection : Inspection
    sharing : str
        ``centralized``, or how a decentralized filter shares (see `Decentralized`).
    strengthening, without, sampled
        See `Families`.
    backup : Backup, optional
        Default: no thrust.
    sun : float
        Angle of the sun at t = 0 [rad].
    patience : float
        [s]
    """

    def __init__(
        self,
        inspection: Inspection,
        sharing: Sharing | str = "centralized",
        strengthening: str | Mapping[str, Strengthening] = "afrl",
        without: Collection[str] = (),
        sampled: SampledData | None = None,
        backup: Backup | None = None,
        sun: float = 0.0,
        patience: float = 5.0,
    ) -> None:
        self.inspection, self.backup, self.sun, self.patience = inspection, backup, sun, patience
        self.families = Families(inspection, strengthening, without, sampled)
        self.batch = (
            Centralized(self.families) if sharing == "centralized" else Decentralized(self.families, sharing)  # type: ignore[arg-type]
        )
        labels = np.array(self.families.labels)
        # Several rows may stand for one constraint; they follow each other.
        self._starts = np.flatnonzero(np.append(True, labels[1:] != labels[:-1]))
        self._names = tuple(labels[self._starts].tolist())
        self.reset()

    def reset(self) -> None:
        """Forget the last states: a new flight begins."""
        N = self.inspection.deputies
        self._x = np.full((N, 6), np.nan)
        self._seen = np.full(N, -np.inf)
        self._u = np.zeros((N, 3))
        self._t = -np.inf

    def filter(self, t: float, x: ArrayLike, u_des: ArrayLike | None) -> Decision:
        """Decide on the inputs of the next control period; see `polaris.asif.decision.RunTimeFilter`.

        Raises
        ------
        ScenarioError
            If the shape of the states or of the desired input is wrong.
        """
        N = self.inspection.deputies
        states = _shaped("x", x, (N, 6))
        reasons: list[str] = []
        if not (np.isfinite(t) and t >= self._t):
            reasons.append(f"time {t} after {self._t}")
            t = self._t if np.isfinite(self._t) else 0.0
        states = self._known(t, states, reasons)
        desired, replaced = self._desired(t, states, u_des, reasons)
        if np.isfinite(states).all():
            decision = self._filtered(t, states, desired, replaced, reasons)
        else:
            decision = _plain(np.zeros((N, 3)), "coast", "; ".join(reasons))
        self._t, self._u = t, decision.u
        return decision

    def _known(self, t: float, x: Array, reasons: list[str]) -> Array:
        """States with the unknown ones predicted from the last known, as long as patience lasts."""
        good = np.isfinite(x).all(axis=1)
        if not good.all():
            x = x.copy()
            for i in np.flatnonzero(~good).tolist():
                age = t - self._seen[i]
                reasons.append(
                    f"state of deputy {i} not finite" + (f" for {age:g} s" if age < np.inf else "")
                )
                x[i] = self._x[i] if age <= self.patience else np.nan
                if age <= self.patience and t > self._t:
                    Phi, Gamma = self.inspection.held(t - self._t)
                    x[i] = Phi @ self._x[i] + Gamma @ self._u[i]
        self._x = x
        self._seen = np.where(good, t, self._seen)
        return x

    def _desired(
        self, t: float, x: Array, u_des: ArrayLike | None, reasons: list[str]
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Desired inputs, the backup's where there are none; and where that was."""
        N = self.inspection.deputies
        if u_des is None:
            reasons.append("no desired input in time")
            desired = np.full((N, 3), np.nan)
        else:
            desired = _shaped("u_des", u_des, (N, 3))
        bad = ~np.isfinite(desired).all(axis=1)
        if bad.any():
            if u_des is not None:
                reasons.append(f"desired input of deputy {np.flatnonzero(bad).tolist()} not finite")
            desired = np.where(bad[:, None], self._backup(t, x), desired)
        return desired, bad

    def _backup(self, t: float, x: Array) -> Array:
        """The backup controller's input; no thrust where it has none to give."""
        if self.backup is None or not np.isfinite(x).all():
            return np.zeros((len(x), 3))
        u = np.asarray(self.backup(t, x), dtype=float)
        limit = self.inspection.thrust_max
        return np.where(np.isfinite(u), np.clip(u, -limit, limit), 0.0)

    def _filtered(
        self, t: float, x: Array, desired: Array, replaced: NDArray[np.bool_], reasons: list[str]
    ) -> Decision:
        sun = self.inspection.sun_angle([t], self.sun)
        # Commands beyond a million times the limit are as good as that; squares of huge ones overflow.
        most = 1e6 * self.inspection.thrust_max
        found = self.batch.batch(x[None], sun, np.clip(desired, -most, most)[None])
        u, status, rows = found.u[0], found.status[0], found.rows
        name = "filtered" if (status > DESIRED).any() else "desired"
        if replaced.any():
            name = "backup"
        if (status >= SHORT).any():
            name = "short"
            reasons.append("no input satisfies all conditions: least violation")
        if (failed := status == FAILED).any():
            name = "backup"
            reasons.append("the program failed")
            u = np.where(failed[:, None], self._backup(t, x), u)
        margins = dict(zip(self._names, np.minimum.reduceat(rows.h[0], self._starts).tolist(), strict=True))
        intervened = (u != desired).any(axis=1) | replaced
        active = self._active(rows, u) if intervened.any() else ()
        return Decision(u, intervened, active, margins, name, "; ".join(reasons) or None)

    def _active(self, rows: Rows, u: Array) -> tuple[str, ...]:
        """Constraints whose condition holds with equality, and thrust limits that are reached."""
        G, bound = rows.G[0], rows.bound[0]
        length = np.sqrt(np.einsum("mv,mv->m", G, G))
        gap = np.einsum("mv,mv->m", G, self.families.relative(u)) - bound
        tight = gap <= TIGHT * length
        names = dict.fromkeys(self.families.labels[k] for k in np.flatnonzero(tight))
        limit = self.inspection.thrust_max
        at_limit = np.flatnonzero((np.abs(u) >= limit * (1 - 1e-12)).any(axis=1))
        return (*names, *(f"thrust[{i}]" for i in at_limit))


def _plain(u: Array, status: str, reason: str) -> Decision:
    return Decision(u, np.ones(len(u), dtype=bool), (), {}, status, reason)


def _shaped(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise ScenarioError(name, value, "must be numbers") from error
    if array.shape != shape:
        raise ScenarioError(name, array.shape, f"must have the shape {shape}")
    return array
