"""Initial conditions of the Monte Carlo: Latin hypercube samples that satisfy every constraint."""

import threading

import numpy as np

from ...model.checks import whole
from ...model.errors import ScenarioError
from ...model.system import Array
from ..constraints.allowable_set import allowable
from ..constraints.families import Families

PATIENCE = 200_000  # samples after which a first one must have been accepted, and so on


class InitialConditions:
    """States inside the safe set, drawn as they are asked for: the same ones in the same order.

    Samples that violate a constraint are removed and drawn again. Threads may share one.

    Parameters
    ----------
    families : Families
        ``h >= 0`` and ``phi >= 0`` are asked for all of them.
    seed : int
    block : int
        Samples per Latin hypercube.

    Attributes
    ----------
    x, sun : ndarray, shapes (K, N, 6) and (K,)
        All accepted so far, of the `drawn`; angles of the sun in rad.
    """

    def __init__(self, families: Families, seed: int = 0, block: int = 4096) -> None:
        from scipy.stats import qmc  # takes longer to load than all the rest of a scenario

        q = families.inspection
        self.families, self.block = families, block
        self.wide = np.tile(np.repeat([q.distance_max, q.speed_max], 3), q.deputies)
        self.sampler = qmc.LatinHypercube(6 * q.deputies + 1, rng=np.random.default_rng(seed))
        self.x = np.empty((0, q.deputies, 6))
        self.sun = np.empty(0)
        self.drawn = 0
        self._lock = threading.Lock()

    def first(self, count: int) -> tuple[Array, Array]:
        """The first so many, shapes (count, N, 6) and (count,) [rad].

        Raises
        ------
        ScenarioError
            If hardly any sample satisfies every constraint (less than one in `PATIENCE`).
        """
        whole("count", count, 1)
        with self._lock:
            while len(self.x) < count:
                if self.drawn >= PATIENCE and len(self.x) * PATIENCE < self.drawn:
                    rule = f"none or hardly any of {self.drawn} samples satisfied every constraint"
                    raise ScenarioError(
                        "count", count, f"{rule}; use fewer deputies, or a smaller or slower cube"
                    )
                self._draw()
            return self.x[:count], self.sun[:count]

    @property
    def acceptance(self) -> float:
        """Share of the samples drawn so far that satisfied everything."""
        return len(self.x) / self.drawn

    def _draw(self) -> None:
        sample = self.sampler.random(self.block)
        x = (self.wide * (2 * sample[:, :-1] - 1)).reshape(self.block, -1, 6)
        sun = 2 * np.pi * sample[:, -1]
        self.drawn += self.block
        # What is quick to see first: h >= 0 alone would not do, it also holds outside, on a fast way back.
        phi = allowable(self.families.inspection, x, sun).values()
        inside = np.flatnonzero(np.all([(values >= 0).all(axis=1) for values in phi], axis=0))
        for part in (inside[k : k + 128] for k in range(0, len(inside), 128)):
            good = part[(self.families(x[part], sun[part]).h >= 0).all(axis=1)]
            self.x = np.concatenate([self.x, x[good]])
            self.sun = np.concatenate([self.sun, sun[good]])
