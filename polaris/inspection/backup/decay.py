"""Linear loops that are let run for ever: totals and peaks of what they put out, and until when they clip.

Bounds on infinite sums: the first terms exactly, the rest by a norm that has shrunk to a thousandth.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_lyapunov

from ...model.errors import ScenarioError
from ...model.system import Array

SHRUNK = 1e-3  # the norm of the loop's power behind which the rest of a sum is bounded geometrically
LONGEST = 8192  # most terms taken exactly; a loop that has not shrunk by then is refused


class Decay:
    """The loop ``s_{k+1} = M s_k`` of d states with r outputs ``C s_k``; the norm is ``norm(s / weight)``.

    A ScenarioError if the loop is not stable, or too slow.
    """

    def __init__(self, M: Array, C: Array, weight: Array) -> None:
        radius = float(np.abs(np.linalg.eigvals(M)).max())
        if radius >= 1:
            rule = "is too long for the gains: the sampled loop is unstable"
            raise ScenarioError("period", f"spectral radius {radius:.4g}", rule)
        scaled = M * weight / weight[:, None]
        count, power = 1, scaled
        while (shrunk := float(np.linalg.norm(power, 2))) > SHRUNK:
            if count >= LONGEST:
                raise ScenarioError("period", f"spectral radius {radius:.6g}", "must be shorter")
            power, count = power @ power, 2 * count
        self.powers = outputs = np.empty((count, *C.shape))
        outputs[0] = C
        for k in range(1, count):
            outputs[k] = outputs[k - 1] @ M
        self._outputs = outputs.reshape(-1, C.shape[1])
        self._shape = (count, len(C))
        self._after = power / weight  # scaled state after `count` steps
        gains = np.linalg.norm(outputs * weight, axis=2)
        self._total_rest = gains.sum(axis=0) / (1 - shrunk)
        self.left = shrunk * self._total_rest
        """Remainders of the totals (r,) after the `powers` (K, r, d), for a state of norm 1."""
        self._peak_rest = gains.max(axis=0)
        self.later = shrunk * self._peak_rest
        """The largest outputs (r,) that are left after the `powers`, for a state of norm 1."""
        self.energy = solve_discrete_lyapunov(M.T, C.T @ C)
        """Matrix P with ``s' P s = sum over k of norm(C s_k)^2``."""

    def never_above(self, s: Array, limit: float) -> NDArray[np.bool_]:
        """Return True if surely no output ever exceeds a limit in size: ``s' P s <= limit^2``, shape (...).

        Sufficient only. It stays true along the loop, because ``s' P s`` decreases.
        """
        return np.asarray(np.einsum("...i,ij,...j->...", s, self.energy, s) <= limit**2)

    def total(self, s: Array) -> Array:
        """Upper bound on ``sum over k of |C s_k|``, shape (..., r); sharp to about `SHRUNK`."""
        exact = np.abs(s @ self._outputs.T).reshape(*s.shape[:-1], *self._shape).sum(axis=-2)
        return np.asarray(exact + self._rest(s)[..., None] * self._total_rest)

    def peak(self, s: Array) -> Array:
        """Upper bound on ``max over k of |C s_k|``, shape (..., r)."""
        exact = np.abs(s @ self._outputs.T).reshape(*s.shape[:-1], *self._shape).max(axis=-2)
        return np.asarray(np.maximum(exact, self._rest(s)[..., None] * self._peak_rest))

    def _rest(self, s: Array) -> Array:
        return np.asarray(np.linalg.norm(s @ self._after.T, axis=-1))
