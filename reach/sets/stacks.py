"""Base of boxes, zonotopes and ellipsoids: two arrays, leading axes as a stack, images of a fixed body."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from ..numerics.checks import Array, as_map, as_numbers, as_vector, require_alike
from ..numerics.errors import ReachError
from .convex import SetOperators


class SetStack(SetOperators):
    """A set, or a stack of them along leading axes of its two arrays (their names in `names`)."""

    names: ClassVar[tuple[str, str]]

    if TYPE_CHECKING:

        def __init__(self, first: ArrayLike, second: ArrayLike) -> None: ...

    @property
    def arrays(self) -> tuple[Array, Array]:
        """The two arrays."""
        return getattr(self, self.names[0]), getattr(self, self.names[1])

    @property
    def dim(self) -> int:
        """Dimension n of the space."""
        return int(self.arrays[0].shape[-1])

    @property
    def batch(self) -> tuple[int, ...]:
        """Leading axes."""
        return self.arrays[0].shape[:-1]

    @classmethod
    def stack(cls, parts: Sequence[Self]) -> Self:
        """Stack sets along a new leading axis, padding with zero generators."""
        valid = isinstance(parts, list | tuple) and parts and all(isinstance(part, cls) for part in parts)
        if not valid or len({(part.dim, part.batch) for part in parts}) > 1:
            raise ReachError(f"a stack needs a sequence of {cls.__name__} of one dimension and shape")
        width = max(part.arrays[1].shape[-1] for part in parts)
        first, second = zip(*(part._pad(width).arrays for part in parts), strict=True)
        return cls(np.stack(first), np.stack(second))

    def _pad(self, count: int) -> Self:
        """The set written with so many columns."""
        return self

    def __getitem__(self, index: Any) -> Self:
        """Select from the batch axes."""
        if not self.batch:
            raise ReachError(f"a single {type(self).__name__} cannot be indexed")
        try:
            parts = [np.asarray(part[index]) for part in self.arrays]
        except (IndexError, TypeError, ValueError) as exc:
            raise ReachError(f"an index selects from the batch axes: {exc}") from None
        if parts[0].ndim == 0 or parts[0].shape[-1] != self.dim:
            raise ReachError(f"an index selects from the batch axes {self.batch} only, got {index!r}")
        return type(self)(*parts)

    def __len__(self) -> int:
        if not self.batch:
            raise ReachError(f"a single {type(self).__name__} has no length")
        return self.batch[0]

    def __add__(self, other: Any) -> Any:
        """Minkowski sum with another set, or translation by vectors that broadcast with the batch."""
        if isinstance(other, SetOperators):
            return super().__add__(other)
        v = as_vector(other, self.dim)
        require_alike(v.shape[:-1], self.batch)
        return self._translated(v)

    def _rows(self, directions: ArrayLike) -> Array:
        D = super()._rows(directions)
        if self.batch and D.ndim > 2:
            require_alike(D.shape[:-2], self.batch)
        return D


class Generated(SetStack):
    """``{c + G b}``, b in a body that is symmetric about the origin."""

    @property
    def center(self) -> Array:
        """Centre of symmetry, shape (..., n)."""
        return self.arrays[0]

    @property
    @abstractmethod
    def half_widths(self) -> Array:
        """Half-widths of the interval hull, shape (..., n)."""

    @property
    def extent(self) -> Array:
        """Elementwise bound on the points, before rounding, shape (..., n)."""
        return np.asarray(np.abs(self.center) + self.half_widths)

    @property
    def terms(self) -> int:
        """Number of products summed in one value of the support function."""
        return self.dim + int(self.arrays[1].shape[-1])

    def __rmatmul__(self, M: ArrayLike) -> Self:
        """Linear image ``M @ X``; M may carry batch axes that broadcast with the set's."""
        c, G = self.arrays
        M = as_map(M, self.dim)
        require_alike(M.shape[:-2], self.batch)
        c = (M @ c[..., None])[..., 0]
        return type(self)(c, np.broadcast_to(M @ G, (*c.shape, G.shape[-1])))

    def _translated(self, v: Array) -> Self:
        c, G = self.arrays
        return type(self)(c + v, np.broadcast_to(G, (*np.shape(c + v), G.shape[-1])))

    def _scaled(self, a: float) -> Self:
        c, G = self.arrays
        return type(self)(a * c, a * G)


def as_center_and_sizes(center: ArrayLike, name: str, sizes: ArrayLike) -> tuple[Array, Array]:
    """A centre and sizes >= 0, broadcast with each other."""
    c, r = as_numbers("center", center), as_numbers(name, sizes)
    try:
        c, r = np.broadcast_arrays(c, r)
    except ValueError:
        raise ReachError(f"center and {name} do not go together: shapes {c.shape}, {r.shape}") from None
    if not np.all(r >= 0):
        raise ReachError(f"{name} must be >= 0, got {r.min():g}")
    if not (np.all(np.isfinite(c)) and np.all(np.isfinite(r))):
        raise ReachError(f"center and {name} must be finite numbers")
    return c, r
