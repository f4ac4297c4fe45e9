"""The figure of a trade-off: share of U against velocity change, with the switches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullLocator

from ...model.checks import counted
from ..scene.palette import BLACK, GREY, PURPLE
from .style import ABOVE, WIDTH, new_figure, save_all, shortened

GAP = 0.14
"""Height of a label [in]."""

SPREAD = 4.0
"""Ratio of the largest velocity change to the least from which on the axis is logarithmic."""

Places = dict[tuple[float, float, int], list[Mapping[str, Any]]]
"""Points by velocity change [m/s], share [%] and switches."""


def draw_tradeoff(points: Sequence[Mapping[str, Any]], folder: Path) -> list[Path]:
    """Draw and write the figure ``tradeoff``, as PDF and PNG."""
    return save_all(((name, _front(points)) for name in ("tradeoff",)), folder)


def _front(points: Sequence[Mapping[str, Any]]) -> Any:
    """Points by velocity change and share, those that no other outdoes joined; prices and switches beside."""
    places: Places = {}
    for point in points:
        place = (point["delta_v_m_s"], 100 * point["weighted_share"], point["switches"])
        places.setdefault(place, []).append(point)
    height = max(2.0, GAP * (len(places) + 1))
    figure = new_figure(height + 0.7, 1.4 * WIDTH)
    ax = figure.add_subplot()
    ax.margins(0.1)
    spent = [place[0] for place in places]
    if max(spent) > SPREAD * min(spent) > 0:
        ax.set_xscale("log")
        ax.xaxis.set_major_locator(LogLocator(subs=(1, 2, 3, 5)))
        ax.xaxis.set_major_formatter("{x:g}")
        ax.xaxis.set_minor_locator(NullLocator())
    front = sorted(place for place, here in places.items() if any(one["non_dominated"] for one in here))
    ax.plot([place[0] for place in front], [place[1] for place in front], color=BLACK, lw=0.9, zorder=2)
    for (x, y, _), here in places.items():
        ax.plot(x, y, "o", color=BLACK if (x, y, _) in front else GREY, ms=4, zorder=3)
        if any(one["price"] is None for one in here):
            ax.plot(x, y, "D", color=PURPLE, ms=8, mfc="none", mew=1.0, zorder=4)
    _label(ax, places, GAP / height)
    weighted = any(point["share"] != point["weighted_share"] for point in points)
    ax.set_ylabel(f"{'Weighted share' if weighted else 'Share'} of time under U (%)")
    ax.set_xlabel("Velocity change, mean over runs (m/s)")
    ax.grid(True)
    handles = [
        Line2D([], [], ls="none", marker=marker, color=colour, mfc=fill, ms=4, label=name)
        for marker, colour, fill, name in (
            ("o", BLACK, BLACK, "no other outdoes it"),
            ("o", GREY, GREY, "outdone"),
            ("D", PURPLE, "none", "printed algorithms"),
        )
    ]
    ax.legend(handles=handles, columnspacing=0.9, **ABOVE)
    return figure


def _label(ax: Any, places: Places, gap: float) -> None:
    """Prices and switches in a column beside the axes, in order of the share, led to their points."""
    low, high = ax.get_ylim()
    order = sorted(places, key=lambda place: (place[1], -place[0]))
    heights = [(place[1] - low) / (high - low) for place in order]
    for i in range(1, len(order)):
        heights[i] = max(heights[i], heights[i - 1] + gap)
    heights[-1] = min(heights[-1], 1.0)
    for i in reversed(range(len(order) - 1)):
        heights[i] = min(heights[i], heights[i + 1] - gap)
    every = [one["price"] for here in places.values() for one in here]
    known = sorted(price for price in every if price is not None)
    for place, height in zip(order, heights, strict=True):
        text = f"{shortened(_prices(places[place], known), 1.4)}, {counted(place[2], 'switch', 'switches')}"
        look = {"arrowstyle": "-", "lw": 0.4, "color": GREY, "shrinkA": 1, "shrinkB": 3}
        where: Any = {"xytext": (1.04, height), "textcoords": "axes fraction", "va": "center", "fontsize": 7}
        ax.annotate(text, place[:2], arrowprops=look, annotation_clip=False, **where)


def _prices(here: Sequence[Mapping[str, Any]], known: Sequence[float]) -> str:
    """Prices of the points at one place, three or more in a row of all that are known as from and to."""
    prices = sorted(one["price"] for one in here if one["price"] is not None)
    names = [f"{price:g}" for price in prices]
    if len(prices) > 2 and prices == [price for price in known if prices[0] <= price <= prices[-1]]:
        names = [f"{names[0]} to {names[-1]}"]
    told = [f"price {', '.join(names)}"] if names else []
    return ", ".join(told + ["printed"] * (len(here) > len(prices)))
