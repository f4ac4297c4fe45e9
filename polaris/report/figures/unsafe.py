"""Unsafe sets in the plane of motion: at rest once, in motion about the closest approach, with the times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...model.keep_in import KeepIn
from ...model.obstacle import Obstacle
from ...model.system import Array
from .closeups import CloseUp, seconds
from .geometry import flat_outline
from .space import Space, moves
from .style import RED, shortened, tint
from .view import View

DASHES = (0, (5, 1.5))

APART = 2.2
"""A moving set is drawn before and after the closest approach where it has moved so many times its width."""


def draw_unsafe(
    ax: Any, space: Space, view: View, found: Sequence[CloseUp] = (), letters: Mapping[int, str] | None = None
) -> None:
    """Draw every unsafe set with its name.

    What is filled is the true set (about the nominal centre, for another satellite); a thin line about the
    closest approach of another satellite is where it is known to be. A moving set is drawn at that instant
    and once before and after, on its dotted way; each time is written at the set and at the chaser's place.
    Dashed: keep-in sets, and sets that the plane does not show to be passed.

    Parameters
    ----------
    ax : matplotlib axes
    space : Space
    view : View
        Of its plane.
    found : sequence of CloseUp
        Passages out of the plane.
    letters : mapping, optional
        Letters of their close-ups, by id.
    """
    for obstacle in space.picture.obstacles:
        own = [one for one in found if one.obstacle is obstacle]
        if isinstance(obstacle, KeepIn):
            _keep_in(ax, space, view, obstacle)
        elif own:
            told = ", ".join(letters[id(one)] for one in own) if letters else ""
            note = f" (see {told})" if told else " (out of plane)"
            _set(ax, space, view, obstacle, [one.time for one in own], note)
        else:
            _set(ax, space, view, obstacle, instants(obstacle, space), "")


def _set(ax: Any, space: Space, view: View, obstacle: Obstacle, times: list[float], note: str) -> None:
    """One set at some instants, the most important one first."""
    axes, moving = space.picture.frame.flat, moves(obstacle, space.picture)
    for order, t in enumerate(times if moving else times[:1]):
        outline = space.wider(1.0).outline(obstacle, t, axes)
        if not len(outline) or not (len(view.seen(outline)) or (not note and _around(outline, view))):
            continue  # out of view; or passed out of the plane, and all of the view
        _one(ax, outline, order == 0, bool(note))
        cover = space.cover(obstacle, t) if order == 0 else None
        if cover is not None:
            rim = flat_outline(cover[:, axes])
            _outline(ax, rim, 0.5, DASHES if note else "-")
            view.avoid(view.seen(rim))
        name = shortened(obstacle.name, 1.5) if order == 0 else ""
        told = f"{seconds(t)} s" if moving else ""
        view.label(
            ax, ", ".join(filter(None, (name, told))) + (note if order == 0 else ""), view.clip(outline), RED
        )
    if moving:
        way = obstacle.centre(np.linspace(0, space.picture.duration, 201), space.picture.system)[:, axes]
        ax.plot(*way.T, color=tint(RED, 0.6), lw=0.6, ls=(0, (1, 2)), zorder=1.4)
        _chaser(ax, space, view, times)


def _around(outline: Array, view: View) -> bool:
    """Whether an outline goes round all of the view."""
    low, high = outline.min(axis=0), outline.max(axis=0)
    return bool(low[0] < view.x[0] and low[1] < view.y[0] and high[0] > view.x[1] and high[1] > view.y[1])


def instants(obstacle: Obstacle, space: Space) -> list[float]:
    """When a set is drawn: at the closest approach, and if it moves once before and after, if in view."""
    picture, axes = space.picture, space.picture.frame.flat
    closest = picture.approach(obstacle).time
    if not moves(obstacle, picture):
        return [0.0]
    times = np.unique(np.append(np.linspace(0, picture.duration, 201), closest))
    centres = np.asarray(obstacle.centre(times, picture.system))
    seen = np.all((centres > space.low) & (centres < space.high), axis=1)
    outline = space.outline(obstacle, closest, axes)
    at = int(np.searchsorted(times, closest))
    if not len(outline):
        return [closest]
    gone = np.linalg.norm((centres - centres[at])[:, axes], axis=1)
    wanted = APART * float(np.max(np.ptp(outline, axis=0)))
    found = [closest]
    for side in (np.arange(at), np.arange(at + 1, len(times))):
        side = side[seen[side] & (gone[side] > 0.5 * wanted)]
        if len(side):
            found.append(float(times[side[np.argmin(np.abs(gone[side] - wanted))]]))
    return found


def _one(ax: Any, outline: Array, closest: bool, aside: bool) -> None:
    from matplotlib.patches import Polygon

    share = 0.45 if closest else 0.2
    look: dict[str, Any] = {"facecolor": tint(RED, share), "edgecolor": "none"}
    if aside:
        look = {"facecolor": "none", "edgecolor": tint(RED, 1.0 if closest else 0.5), "ls": DASHES, "lw": 0.7}
    ax.add_patch(Polygon(outline, zorder=1.5, **look))
    if not aside:
        _outline(ax, outline, 0.6, "-", 1.0 if closest else 0.5)


def _outline(ax: Any, outline: Array, width: float, dashes: Any, share: float = 1.0) -> None:
    from matplotlib.patches import Polygon

    edge = tint(RED, share)
    ax.add_patch(Polygon(outline, facecolor="none", edgecolor=edge, lw=width, ls=dashes, zorder=1.6))


def _chaser(ax: Any, space: Space, view: View, times: list[float]) -> None:
    """Where the chaser is at the instants at which a moving set is drawn."""
    known, path = space.picture.safe_path()
    for t in times:
        spot = path[int(np.argmin(np.abs(known - t)))][space.picture.frame.flat]
        if view.contains(spot):
            ax.plot(*spot, "o", ms=3, mfc="white", mec=RED, mew=0.7, zorder=6)
            view.label(ax, f"{seconds(t)} s", spot[None], RED)


def _keep_in(ax: Any, space: Space, view: View, obstacle: KeepIn) -> None:
    """Draw a keep-in set and write its name at the end of its edge that is in view."""
    rim = flat_outline(space.wider(1.0).corners(obstacle, 0.0)[:, space.picture.frame.flat])
    seen = view.seen(rim) if len(rim) else rim
    if len(seen):
        _outline(ax, rim, 0.8, DASHES)
        far = seen[np.argmax(np.linalg.norm(seen - view.points.mean(axis=0), axis=1))]
        view.avoid(seen)
        view.label(ax, f"{shortened(obstacle.name, 1.5)} (stay inside)", far[None], RED)
