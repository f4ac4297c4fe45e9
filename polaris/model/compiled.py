"""Plain loops over arrays that numba compiles, where it is installed (the extra ``fast``)."""

import os
from collections.abc import Callable
from functools import cache, partial
from importlib import import_module
from types import ModuleType
from typing import Any, TypeVar

import numpy as np

from reach.numerics.packages import unusable

from .system import Array

Loop = TypeVar("Loop", bound=Callable[..., Any])


def is_enabled() -> bool:
    """Return True if numba is there in a tested version, and POLARIS_COMPILED is not set to 0."""
    return not unusable("numba") and os.environ.get("POLARIS_COMPILED", "1") != "0"


def plain(x: Array) -> Array:
    """Numbers in C order and writeable: for any others, compiled loops would be compiled anew."""
    flags = x.flags
    good = flags.c_contiguous and flags.writeable and x.dtype == np.float64
    return x if good else np.array(x, dtype=np.float64, order="C")


def compiled(loop: Loop, inline: bool = False) -> Loop:
    """Compile a function of loops, at its first call or into its callers; without numba it stands as it is.

    What is compiled is kept on disk, by its file alone: such a function calls no function of another file,
    and takes constants of other files as arguments. Operations keep their order and their rounding.
    """
    if unusable("numba"):
        return loop
    import numba

    options = {"error_model": "numpy", "nogil": True, "forceinline": inline}
    try:
        function: Loop = numba.njit(cache=True, **options)(loop)
    except RuntimeError:  # nowhere to keep it
        function = numba.njit(**options)(loop)
    return function


inlined = partial(compiled, inline=True)
"""For functions that `compiled` ones of their file call many times: the call costs more than they do."""


@cache
def _module(name: str) -> ModuleType:
    return import_module(name)


def loops(name: str) -> Any:
    """The module of compiled loops of this name, imported when it is first wanted; None if it is not."""
    return _module(name) if is_enabled() else None
