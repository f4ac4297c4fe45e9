"""Figures of a comparison and of a trade-off: where every method flew, and what was gained and lost."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from io import BytesIO
from typing import Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullLocator

from ...model.checks import counted
from ...runs.comparison import ComparisonData
from ..scene.items import alone, under_mode
from ..scene.palette import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, RED
from ..scene.scene import describe
from .cuts import mark_cuts
from .labels import name
from .scene import draw_unsafe, frame_axes
from .style import DASHES, DOTS, WIDTH, dot, legend_above, new_figure, printing, shortened, text_width

MODES = ((1, ORANGE, "U's input"), (-1, GREY, "filtered input"), (0, BLUE, "S"))
TITLES = ((GREEN, "with a proof"), (RED, "without a proof"))
REFERENCE: Mapping[str, Any] = {"color": GREY, "lw": 0.6, "ls": DOTS}
ALONE: Mapping[str, Any] = {"lw": 0.6, "ls": DASHES}

Methods = Sequence[Mapping[str, Any]]

PANELS: tuple[tuple[str, str, bool], ...] = (  # metric, label, and whether its axis is logarithmic
    ("min_distance_m", "Minimum distance\n(m)", False),
    ("experimental_share", "Share of time\nunder U", False),
    ("delta_v_m_s", "Delta-v\n(m/s)", False),
    ("deviation", "Deviation from\nU's input", False),
    ("decision_median_us", "Decision\n(µs)", True),
)


def tradeoffs_png(methods: Methods) -> bytes:
    """The figure ``tradeoffs`` as a picture for a page."""
    file = BytesIO()
    with printing():
        _tradeoffs(methods).savefig(file, format="png", dpi=180, metadata={"Software": "polaris"})
    return file.getvalue()


def _available(methods: Methods) -> Methods:
    return [method for method in methods if method.get("available", True)]


def _tradeoffs(methods: Methods) -> Any:
    """Metrics of every method with intervals."""
    methods = _available(methods)
    panels = [panel for panel in PANELS if any(method["metrics"].get(panel[0]) for method in methods)]
    figure = new_figure(0.8 + 0.22 * len(methods), 7.2)
    y = -np.arange(len(methods))
    if not panels:
        return figure
    axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for ax, (metric, label, logarithmic) in zip(axes, panels, strict=True):
        for place, method in zip(y, methods, strict=True):
            colour = GREEN if method["guarantee"] == "proved" else RED
            value = method["metrics"].get(metric)
            value = value if isinstance(value, dict) else {"mean": value}
            mean, low, high, worst = (value.get(name) for name in ("mean", "low", "high", "worst"))
            if mean is None:
                continue
            if low is not None and high is not None:
                ax.plot([low, high], [place, place], color=colour, lw=1.4)
            ax.plot(mean, place, "o", ms=3.2, color=colour)
            if worst is not None:
                ax.plot(worst, place, "|", ms=6, mew=1.0, color=colour)
        if logarithmic:
            ax.set_xscale("log")
        elif metric == "min_distance_m":
            ax.axvline(0, color=RED, lw=0.6, ls=":")
        else:
            ax.set_xlim(left=0)
        ax.set_xlabel(label)
        ax.grid(True, axis="x")
        ax.tick_params(axis="y", length=0)
    axes[0].set_yticks(y, [shortened(str(method["name"]), 2.4) for method in methods])
    handles = [dot("o", colour, 3.2, f"mean, {name}") for colour, name in TITLES]
    handles += [Line2D([], [], color=GREY, lw=1.4, label="95 % bounds"), dot("|", GREY, 6, "worst run")]
    figure.legend(handles=handles, loc="outside upper center", ncols=4, fontsize=7)
    return figure


def _paths(results: ComparisonData) -> Any:
    """Every method's run that came closest."""
    picture, methods, flights = results.run.plot_data(), _available(results.table["methods"]), results.shown
    if picture.system.d == 1:
        return None
    bare = replace(picture, tube=None, slices=None)
    view = describe(bare)
    aspect = float(np.divide(*(view.high - view.low)[::-1]))
    columns = 3 if aspect < 0.8 else 4
    rows = -(-len(methods) // columns)
    width = 7.2
    figure = new_figure(rows * (width / columns * aspect + 0.4) + 0.7, width)
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    flat, frame = picture.frame.flat, picture.frame
    for ax in grid.flat[len(methods) :]:
        ax.set_axis_off()
    cut: list[Any] = []
    for ax, method in zip(grid.flat, methods, strict=False):
        frame_axes(ax, view)
        one = flights.get(method["key"])
        # The distance tells whether a set is passed or entered, which a plane need not show.
        words = "not flown" if one is None else f"minimum distance {float(one.nearest[0].min()):.3g} m"
        title = f"{_in_lines(str(method['name']), width / columns - 0.45)}\n{words}"
        colour = GREEN if method["guarantee"] == "proved" else RED
        ax.set_title(title, fontsize=7, linespacing=1.1, pad=3, color=colour)
        ax.tick_params(labelsize=6)
        ax.plot(*picture.path()[0][:, flat].T, **REFERENCE, zorder=2)
        for u in [] if one is None else alone(picture):  # beside every method
            ax.plot(*picture.positions(u.flights)[:, flat].T, color=u.colour, **ALONE, zorder=3)
        shown_sets = describe(replace(bare, flights={} if one is None else {"polaris": one}))
        draw_unsafe(ax, replace(shown_sets, low=view.low, high=view.high), named=False)
        if one is not None:
            path = (one.states[0] @ picture.system.position.T)[:, flat]
            for mode, colour, _ in MODES:
                chosen = one.modes[0] > 0 if mode > 0 else one.modes[0] == mode
                if chosen.any():
                    ax.plot(*under_mode(path, chosen).T, color=colour, lw=1.1, zorder=4)
        cut = mark_cuts(ax) or cut
    figure.supxlabel(frame.labels[0], fontsize=7)
    figure.supylabel(frame.labels[1], fontsize=7)
    handles = [Line2D([], [], color=colour, lw=1.4, label=name) for _, colour, name in MODES]
    handles.append(Line2D([], [], label="reference", **REFERENCE))
    handles += [Line2D([], [], color=u.colour, label=u.short, **ALONE) for u in alone(picture)]
    handles.append(dot("o", RED, 3, "nearest to a moving set", mfc="white"))
    handles += [*cut, *(dot("s", colour, 4, name) for colour, name in TITLES)]
    figure.legend(handles=handles, loc="outside upper center", ncols=5, fontsize=7)
    return figure


SPREAD = 4.0  # ratio of the largest velocity change to the least from which on the axis is logarithmic

Places = dict[tuple[float, float, int], list[Mapping[str, Any]]]
"""Points by velocity change [m/s], share [%] and switches."""


def _in_lines(text: str, width: float) -> str:
    """Return a name in one line, or in two if it is wider than this [in]."""
    words = text.split()
    fit = max([k for k in range(1, len(words) + 1) if text_width(" ".join(words[:k])) <= width], default=1)
    return "\n".join(shortened(" ".join(part), width) for part in (words[:fit], words[fit:]) if part)


def _front(points: Sequence[Mapping[str, Any]]) -> Any:
    """Points by velocity change and share, those that no other outdoes joined; with prices and switches."""
    places: Places = {}
    for point in points:
        place = (point["delta_v_m_s"], 100 * point["weighted_share"], point["switches"])
        places.setdefault(place, []).append(point)
    figure = new_figure(2.7 + 0.07 * len(places), 1.4 * WIDTH)
    ax = figure.add_subplot()
    ax.margins(0.1)
    costs = [place[0] for place in places]
    if max(costs) > SPREAD * min(costs) > 0:
        ax.set_xscale("log")
        ax.xaxis.set_major_locator(LogLocator(subs=(1, 2, 3, 5)))
        ax.xaxis.set_major_formatter("{x:g}")
        ax.xaxis.set_minor_locator(NullLocator())
    front = sorted(place for place, group in places.items() if any(one["non_dominated"] for one in group))
    ax.plot([place[0] for place in front], [place[1] for place in front], color=BLACK, lw=0.9, zorder=2)
    for (x, y, _), group in places.items():
        ax.plot(x, y, "o", color=BLACK if (x, y, _) in front else GREY, ms=4, zorder=3)
        if any(one["value"] is None for one in group):
            ax.plot(x, y, "D", color=PURPLE, ms=8, mfc="none", mew=1.0, zorder=4)
    prices = sorted(point["value"] for point in points if point["value"] is not None)
    for (x, y, switches), group in places.items():
        name(ax, f"{_prices(group, prices)}, {counted(switches, 'switch', 'switches')}", [[x, y]], BLACK)
    weighted = any(point["share"] != point["weighted_share"] for point in points)
    ax.set_ylabel(f"{'Weighted share' if weighted else 'Share'} of time under U (%)")
    ax.set_xlabel("Delta-v, mean over runs (m/s)")
    ax.grid(True)
    handles = [dot("o", BLACK, 4, "no other outdoes it"), dot("o", GREY, 4, "outdone")]
    handles.append(dot("D", PURPLE, 4, "printed algorithms", mfc="none"))
    legend_above(ax, handles, 3)
    return figure


def _prices(group: Sequence[Mapping[str, Any]], all_prices: Sequence[float]) -> str:
    """Prices of the points at one place, three or more in a row of all that are known as from and to."""
    prices = sorted(one["value"] for one in group if one["value"] is not None)
    names = [f"{price:g}" for price in prices]
    if len(prices) > 2 and prices == [price for price in all_prices if prices[0] <= price <= prices[-1]]:
        names = [f"{names[0]} to {names[-1]}"]
    words = [f"price {', '.join(names)}"] if names else []
    return ", ".join(words + ["printed"] * (len(group) > len(prices)))


FIGURES = {"tradeoffs": lambda shown: _tradeoffs(shown.table["methods"]), "paths": _paths}
"""Figures of a comparison."""

LINES = {  # lines against a field's values: colour, factor and name
    "share": (ORANGE, 100, "share"),
    "delta_v_m_s": (BLUE, 1, "mean m/s"),
    "delta_v_most_m_s": (GREY, 1, "proven m/s"),
}


def _sensitivity(points: Sequence[Mapping[str, Any]]) -> Any:
    """Share of U and velocity change against the values of every field; infeasible ones at the foot."""
    fields = list(dict.fromkeys(point["field"] for point in points))
    figure = new_figure(0.4 + 1.7 * len(fields), 1.4 * WIDTH)
    for ax, field in zip(figure.subplots(len(fields), squeeze=False)[:, 0], fields, strict=True):
        rows = sorted((one for one in points if one["field"] == field), key=lambda one: float(one["value"]))
        values, twin = np.array([one["value"] for one in rows], dtype=float), ax.twinx()
        if values.min() > 0 and values.max() > SPREAD * values.min():
            ax.set_xscale("log")
        for key, (colour, scale, _) in LINES.items():
            heights = np.array([np.nan if row[key] is None else scale * row[key] for row in rows])
            one = ax if key == "share" else twin
            one.plot(values, heights, "o-", color=colour, ms=3, lw=0.9)
        infeasible = values[[row["guarantee"] == "infeasible" for row in rows]]
        if len(infeasible):
            ax.plot(infeasible, 0 * infeasible, "x", color=RED, ms=5, clip_on=False)
        ax.set(ylim=(0, 105), xlabel=field, ylabel="Share of U (%)")
        twin.set(ylim=(0, None), ylabel="Delta-v (m/s)")
        ax.grid(True)
    handles = [dot("o", colour, 4, name) for colour, _, name in LINES.values()]
    handles.append(dot("x", RED, 4, "infeasible"))
    figure.legend(handles=handles, loc="outside upper center", ncols=4, fontsize=7)
    return figure


TRADEOFF = {  # figures of a trade-off; points without a front are those of fields
    "tradeoff": lambda points: (_sensitivity if points[0]["non_dominated"] is None else _front)(points)
}
