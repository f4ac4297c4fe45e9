"""Paths, coloured by who flew them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...model.system import Array
from ...runs.picture import Picture
from .geometry import stretches
from .style import GREY, mode_colour

if TYPE_CHECKING:
    from ...simulation.baselines import Flights

DOTS = (0, (1, 1.4))
DASHES = (0, (3, 1.2))


def under_mode(flown: Array, flags: Any) -> Array:
    """The stretches of a path flown under one mode, gaps between them: one line to draw.

    Parameters
    ----------
    flown : ndarray, shape (N+1, d)
    flags : ndarray of bool, shape (N,)
        Whether the mode flies from each point to the next.
    """
    gap = np.full((1, flown.shape[1]), np.nan)
    return np.vstack([gap[:0], *(part for a, b in stretches(flags) for part in (flown[a : b + 1], gap))])


def modes_per_node(flights: Flights) -> NDArray[np.int_]:
    """Who flies from each node to the next, shape (N,)."""
    return np.repeat(flights.modes, (len(flights.times) - 1) // len(flights.modes))


def by_mode(picture: Picture, shown: Array, span: tuple[int, int] | None = None) -> dict[int, Array]:
    """The first run under Polaris in pieces, by mode: the one that flew most first, so that none is hidden.

    Parameters
    ----------
    picture : Picture
        With this run.
    shown : ndarray, shape (N+1, 2)
        Where to draw its nodes.
    span : (int, int), optional
        First and one-past-last node to draw.
    """
    a, b = (0, len(shown)) if span is None else span
    who = modes_per_node(picture.flights["polaris"])[a : b - 1]
    modes, counts = np.unique(who, return_counts=True)
    order = modes[np.argsort(-counts, kind="stable")]
    return {int(mode): under_mode(shown[a:b], who == mode) for mode in order}


def draw_safe_path(ax: Any, picture: Picture, shown: Array, span: tuple[int, int] | None = None) -> list[int]:
    """Draw the run under Polaris by mode, or the reference without one; the modes drawn."""
    if "polaris" not in picture.flights:
        ax.plot(*shown[slice(*(span or (0, len(shown))))].T, color=GREY, lw=1.1, ls=DOTS, zorder=4.5)
        return []
    pieces = by_mode(picture, shown, span)
    for order, (mode, piece) in enumerate(pieces.items()):
        look = {"lw": 1.5, "zorder": 4 + 0.01 * order, "solid_capstyle": "butt"}
        ax.plot(*piece.T, color=mode_colour(mode), **look)
    return list(pieces)
