"""Leads of pulses over inputs that are held for the same impulse (docs/theory.md, Lemma 6 (b))."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .system import Array


@dataclass(frozen=True)
class Lead:
    """Bounds on the mean impulses of a period by which pulses are ahead of held inputs, or behind [N s]."""

    shares: tuple[tuple[float, ...], ...]  # of each input, rows, by a unit of each command, (m, m)
    fixed: tuple[float, ...]  # whatever is commanded, (m,)
    most: tuple[float, ...]  # besides, however much is commanded, (m,)

    @property
    def least(self) -> Lead:
        """Return the leads under no command."""
        return replace(self, most=(0.0,) * len(self.most))

    def part(self, u: Array) -> Array:
        """Return the part that is proportional to commands up to u at most, (..., m); subadditive."""
        return np.asarray(np.minimum(u @ np.array(self.shares).T, np.array(self.most)))
