"""The allowable set with gradients: phi1 to phi6 and phi9 to phi11 of all deputies and pairs, as rows.

phi4 and phi5 are taken as signed distances from the cone [m] instead of angles, with the same sign.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from ...model.errors import ScenarioError
from ...model.system import Array
from ..inspection import Inspection

KINDS = ("phi1", "phi2", "phi3", "phi4", "phi5+", "phi5-", "phi6", "phi9", "phi10", "phi11")


def dot(a: Array, b: Array) -> Array:
    """Inner products along the last axis."""
    return np.asarray((a * b).sum(axis=-1))


@dataclass(frozen=True, eq=False)
class PhiValues:
    """Constraints at S instants.

    Attributes
    ----------
    value : ndarray, shape (S, M)
    gradient : ndarray, shape (S, M, 6)
        By the state of the first deputy; by the second's it is the negative.
    change : ndarray, shape (S, M)
        Explicit rate of change with time, by the turning sun [1/s].
    """

    value: Array
    gradient: Array
    change: Array


class AllowableRows:
    """The constraints phi of all deputies and pairs, in one fixed order of rows.

    Parameters
    ----------
    inspection : Inspection
    without : collection of str
        Kinds left out, of "phi1" to "phi6" and "phi9" to "phi11".

    Attributes
    ----------
    kind : tuple of str, length M
    first, second : ndarray of int, shape (M,)
        The deputies of each row; second is -1 where there is one only.
    labels : tuple of str, length M
    """

    def __init__(self, inspection: Inspection, without: Collection[str] = ()) -> None:
        q = self.inspection = inspection
        names = {kind.rstrip("+-") for kind in KINDS}
        for name in without:
            if name not in names:
                raise ScenarioError("without", name, f"must be one of {', '.join(sorted(names))}")
        self._kinds = [k for k in KINDS if k.rstrip("+-") not in without]
        alone = np.stack([np.arange(q.deputies), np.full(q.deputies, -1)], axis=1)
        who = [q.pairs if k[:4] in ("phi2", "phi5") else alone for k in self._kinds]
        self.kind = tuple(k for k, members in zip(self._kinds, who, strict=True) for _ in members)
        self.first, self.second = np.concatenate(who or [alone[:0]]).T
        self.labels = tuple(
            f"{k}[{i},{j}]" if j >= 0 else f"{k}[{i}]"
            for k, i, j in zip(self.kind, self.first, self.second, strict=True)
        )
        self.is_speed = np.array([k in ("phi3", "phi9", "phi10", "phi11") for k in self.kind])
        self.is_cone = np.array([k[:4] in ("phi4", "phi5") for k in self.kind])

    def relative(self, x: Array) -> Array:
        """State that each row is about, shape (..., M, 6), of states (..., N, 6)."""
        own = x[..., self.first, :]
        return np.where((self.second >= 0)[:, None], own - x[..., self.second, :], own)

    def __call__(self, x: Array, sun: Array) -> PhiValues:
        """Evaluate at states (S, N, 6) and sun angles (S,) [rad]."""
        q = self.inspection
        apart = x[:, q.pairs[:, 0]] - x[:, q.pairs[:, 1]]
        parts = []
        for kind in self._kinds:
            z = apart if kind[:4] in ("phi2", "phi5") else x
            if kind in ("phi1", "phi2", "phi6"):
                radius = {"phi1": q.separation, "phi2": 2 * q.deputy_radius, "phi6": q.distance_max}[kind]
                parts.append(_sphere(z, radius, -1.0 if kind == "phi6" else 1.0))
            elif kind == "phi3":
                parts.append(_slower(z, q.docking_speed, q.nu_1))
            elif self._cone(kind):
                side = -1.0 if kind == "phi5-" else 1.0
                parts.append(_cone(z, sun[:, None], q.field_of_view / 2, q.mean_motion, side))
            else:
                parts.append(_axis(z, int(kind[3:]) - 9, q.speed_max))
        value, gradient, change = (np.concatenate(part, axis=1) for part in zip(*parts, strict=True))
        return PhiValues(value, gradient, change)

    @staticmethod
    def _cone(kind: str) -> bool:
        return kind[:4] in ("phi4", "phi5")

    def between(self, value: Array, x: Array, period: float, push: float) -> Array:
        """Lower bounds between each two samples, shape (S-1, M).

        Parameters
        ----------
        value : ndarray, shape (S, M)
        x : ndarray, shape (S, N, 6)
            Samples `period` [s] apart.
        push : float
            Largest acceleration by thrust of one deputy [m/s^2], constant between samples.

        Notes
        -----
        Distances change no faster than the position moves (seen from the turning cone, for phi4 and
        phi5): between two samples they are at least the mean of both less half the path. Speeds lie on
        a chord but for the jerk; the largest is at an end.
        """
        q = self.inspection
        n, D = q.mean_motion, period
        z = self.relative(x)
        r = np.sqrt(dot(z[..., :3], z[..., :3]))
        v = np.sqrt(dot(z[..., 3:], z[..., 3:]))
        r, v = np.maximum(r[1:], r[:-1]), np.maximum(v[1:], v[:-1])
        thrust = np.where(self.second >= 0, 2.0, 1.0) * push
        slip = v + np.where(self.is_cone, n * r, 0.0)
        natural = 3 * n**2 * r + 2 * n * v
        path = D * (slip + 1.2 * (thrust + natural) * D / 2)
        middle = (value[1:] + value[:-1] - path) / 2
        jerk = 1.2 * (3 * n**2 * v + 2 * n * (thrust + natural)) * D**2 / 8
        speeds = np.minimum(value[1:], value[:-1]) - np.where(
            np.array(self.kind) == "phi3", jerk + q.nu_1 * path / 2, 2 * v * jerk
        )
        return np.where(self.is_speed, speeds, middle)


def _sphere(z: Array, radius: float, side: float) -> tuple[Array, Array, Array]:
    r = np.sqrt(dot(z[..., :3], z[..., :3]))
    gradient = np.zeros(z.shape)
    gradient[..., :3] = side * z[..., :3] / np.maximum(r, 1e-9)[..., None]
    return side * (r - radius), gradient, np.zeros(r.shape)


def _slower(z: Array, docking_speed: float, slope: float) -> tuple[Array, Array, Array]:
    r, v = (np.sqrt(dot(part, part)) for part in (z[..., :3], z[..., 3:]))
    gradient = np.empty(z.shape)
    gradient[..., :3] = slope * z[..., :3] / np.maximum(r, 1e-9)[..., None]
    gradient[..., 3:] = -z[..., 3:] / np.maximum(v, 1e-9)[..., None]
    return docking_speed + slope * r - v, gradient, np.zeros(r.shape)


def _axis(z: Array, axis: int, limit: float) -> tuple[Array, Array, Array]:
    v = z[..., 3 + axis]
    gradient = np.zeros(z.shape)
    gradient[..., 3 + axis] = -2 * v
    return limit**2 - v**2, gradient, np.zeros(v.shape)


def _cone(z: Array, sun: Array, half: float, n: float, side: float) -> tuple[Array, Array, Array]:
    """Signed distance from the line through the apex that eq. 34 projects onto; >= 0 outside the cone."""
    p = z[..., :3]
    x, y = -side * np.cos(sun), -side * np.sin(sun)
    along = p[..., 0] * x + p[..., 1] * y
    outward = np.array(p)
    outward[..., 0] -= along * x
    outward[..., 1] -= along * y
    radius = np.sqrt(dot(outward, outward))
    outward /= np.maximum(radius, 1e-9)[..., None]
    gradient = np.zeros(z.shape)
    gradient[..., :3] = np.cos(half) * outward
    gradient[..., 0] -= np.sin(half) * x
    gradient[..., 1] -= np.sin(half) * y
    # The cone turns at -n: what the sun's turning changes is what turning the position back would.
    change = n * (gradient[..., 1] * p[..., 0] - gradient[..., 0] * p[..., 1])
    return np.cos(half) * radius - np.sin(half) * along, gradient, change
