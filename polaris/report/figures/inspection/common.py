"""What the figures of the inspection problem share: colours of the deputies, safe and unsafe regions."""

from __future__ import annotations

from typing import Any

from ....inspection.inspection import Inspection
from ..style import BLACK, BLUE, GREEN, ORANGE, PURPLE, RED, SKY, VERMILION, tint

COLOURS = (BLUE, VERMILION, PURPLE, BLACK, ORANGE, SKY, "#8C6D1F", "#5B5B5B")
"""One for each deputy, from the palette of the other figures; green and red stand for safe and unsafe."""

DASHES: tuple[Any, ...] = ("-", (0, (5, 1.2)), (0, (1.2, 1)), (0, (4, 1, 1, 1)), (0, (2, 1)))

SAFE, UNSAFE = tint(GREEN, 0.14), tint(RED, 0.16)

MOST_NAMED = 10
"""Most lines that a legend names."""


def colour(deputy: int) -> str:
    """Colour of a deputy."""
    return COLOURS[deputy % len(COLOURS)]


def pair_style(pair: Any) -> tuple[str, Any]:
    """Colour (of its first deputy) and dashes (of its second) of a pair."""
    return colour(int(pair[0])), DASHES[int(pair[1]) % len(DASHES)]


def deputy_handles(inspection: Inspection) -> list[Any]:
    """Legend entries of the deputies, none if there are too many or only one."""
    from matplotlib.lines import Line2D

    count = inspection.deputies
    if not 1 < count <= MOST_NAMED:
        return []
    return [Line2D([], [], color=colour(i), label=f"{i}") for i in range(count)]


def pair_handles(inspection: Inspection) -> list[Any]:
    """Legend entries of the pairs, none if there are too many."""
    from matplotlib.lines import Line2D

    if not 0 < len(inspection.pairs) <= MOST_NAMED:
        return []
    styles = [(pair, pair_style(pair)) for pair in inspection.pairs]
    return [Line2D([], [], color=c, ls=d, lw=1.0, label=f"{p[0]}, {p[1]}") for p, (c, d) in styles]


def shade(ax: Any, low: float, high: float, limits: list[tuple[float, bool]]) -> None:
    """Shade an axis of values: safe, and unsafe beyond each limit (value, whether above it is unsafe)."""
    ax.axhspan(low, high, color=SAFE, lw=0, zorder=0)
    for value, above in limits:
        ax.axhspan(value, high if above else low, color=UNSAFE, lw=0, zorder=0.1)
        ax.axhline(value, color=RED, lw=0.7, zorder=0.2)
    ax.set_ylim(low, high)


def tell(ax: Any, text: str, x: float, y: float, **options: Any) -> None:
    """Write the name of a limit in its colour."""
    ax.text(x, y, text, color=RED, fontsize=6.5, zorder=6, **options)


def legend(ax: Any, handles: list[Any], title: str, columns: int) -> None:
    """Put a legend with a title on one line above the axes."""
    from matplotlib.lines import Line2D

    if handles:
        head = Line2D([], [], ls="none", label=title)
        ax.legend(
            handles=[head, *handles],
            loc="lower left",
            bbox_to_anchor=(-0.02, 1.0),
            ncols=columns,
            handlelength=1.2,
            columnspacing=0.7,
            handletextpad=0.3,
            labelspacing=0.25,
        )
