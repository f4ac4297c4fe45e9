"""Style of printed figures: readable at column width, in plain text, the same bytes every time."""

import atexit
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from fontTools import subset
from matplotlib import font_manager, get_data_path
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.textpath import text_to_path
from matplotlib.ticker import AutoLocator

from ...model.system import Array
from ...runs.plot_data import PlotData
from ..scene.items import by_mode
from ..scene.palette import GREY, mode_colour

WIDTH = 3.5  # width of a figure [in]: one column of a two-column page

DOTS, DASHES, LONG, GOAL_DASHES = (0, (1, 1.4)), (0, (3, 1.2)), (0, (5, 1.5)), (0, (4, 2))

_STYLE: Any = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    **dict.fromkeys(("font.size", "axes.labelsize", "axes.titlesize"), 8),
    **dict.fromkeys(("xtick.labelsize", "ytick.labelsize", "legend.fontsize"), 7),
    **dict.fromkeys(("axes.linewidth", "xtick.major.width", "ytick.major.width", "patch.linewidth"), 0.6),
    **dict.fromkeys(("xtick.major.size", "ytick.major.size"), 2.5),
    "lines.linewidth": 1.2,
    "legend.frameon": False,
    "legend.handlelength": 1.6,
    "legend.columnspacing": 1.2,
    "legend.handletextpad": 0.5,
    "legend.borderaxespad": 0.2,
    **dict.fromkeys(("axes.spines.top", "axes.spines.right"), False),
    "axes.axisbelow": True,
    # A power of ten apart from the ticks would stand in the legend.
    "axes.formatter.limits": (-6, 7),
    "axes.formatter.useoffset": False,
    "grid.color": "#E4E4E4",
    "grid.linewidth": 0.4,
    "savefig.dpi": 300,
    "pdf.fonttype": 42,
    "path.simplify": True,
    # Figures ask for their layout themselves.
    **dict.fromkeys(("figure.autolayout", "figure.constrained_layout.use"), False),
}


@contextmanager
def style() -> Iterator[None]:
    """Apply the house style while figures are drawn and saved; the user's own settings come back after."""
    with matplotlib.rc_context(_STYLE):
        yield


@contextmanager
def printing() -> Iterator[None]:
    """The house style with a font that is quick to embed."""
    with style(), matplotlib.rc_context({"font.family": [_light_font(), "DejaVu Sans"]}):
        yield


@cache
def _light_font() -> str:
    """Name of a copy of DejaVu Sans with few letters: to search all of it takes longer than to draw."""
    options = subset.Options(legacy_kern=True, glyph_names=True, notdef_outline=True)
    options.drop_tables += ["FFTM", "GDEF", "GPOS", "GSUB", "MATH"]
    font = subset.load_font(str(Path(get_data_path(), "fonts", "ttf", "DejaVuSans.ttf")), options)
    subsetter = subset.Subsetter(options)
    letters = [*range(0x20, 0x180), *range(0x370, 0x400), *range(0x2010, 0x2060), 0x2212, 0x25CB]
    subsetter.populate(unicodes=letters)
    subsetter.subset(font)
    for entry in font["name"].names:
        if entry.nameID in (1, 3, 4, 6):  # a changed font needs a name of its own
            entry.string = "PolarisSans"
        elif entry.nameID == 2:
            entry.string = "Regular"
    folder = tempfile.mkdtemp(prefix="polaris-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    path = Path(folder, "PolarisSans.ttf")
    font.save(path)
    font.close()
    font_manager.fontManager.addfont(path)
    return "PolarisSans"


def new_figure(height: float, width: float = WIDTH) -> Any:
    """Return an empty figure that no window and no global state knows of."""
    # The resolution it is saved with, so that the layout is that of what is printed.
    return Figure(figsize=(width, height), dpi=_STYLE["savefig.dpi"], layout="constrained")


def save_all(figures: Iterable[tuple[str, Any]], folder: Path) -> list[Path]:
    """Draw and write named figures as PDF and PNG, with nothing in them that changes from run to run."""
    paths: list[Path] = []
    with printing():
        for name, figure in figures:
            # The layout is solved once. As long as a figure has an engine, each format is drawn twice.
            engine = figure.get_layout_engine()
            if engine is not None:
                engine.execute(figure)
            figure.set_layout_engine(None)
            pdf, png = folder / f"{name}.pdf", folder / f"{name}.png"
            figure.savefig(pdf, metadata={"CreationDate": None, "Creator": "polaris", "Producer": None})
            figure.savefig(png, metadata={"Software": "polaris"})
            paths += [pdf, png]
    return paths


def keep_ticks(axes: Iterable[Any]) -> None:
    """Settle how many ticks axes have and their type size: else both change as matplotlib draws."""
    for ax in axes:
        ax.tick_params(labelsize=_STYLE["xtick.labelsize"])
        place = ax.get_position(original=True)
        for axis in (ax.xaxis, ax.yaxis):
            if not isinstance(axis.get_major_locator(), AutoLocator):
                continue
            count = min(max(axis.get_tick_space(), 1), 9)
            if axis is ax.xaxis:
                texts = axis.get_major_formatter().format_ticks(axis.get_majorticklocs())
                widest = max(map(text_width, texts), default=0.0) + 0.04
                width = place.width * ax.figure.get_figwidth() - 0.3  # what the layout may take of it
                count = max(min(count, int(width / widest)), 1)
            axis.get_major_locator().set_params(nbins=count, min_n_ticks=min(count, 2))


def text_width(text: str) -> float:
    """Width of a text of 7 points [in], with an allowance for fitting letters to pixels."""
    font = FontProperties(size=7.0)
    return 1.05 * float(text_to_path.get_text_width_height_descent(text, font, False)[0]) / 72


def shortened(text: str, width: float) -> str:
    """A text, its end cut off if it is wider than this [in]."""
    if text_width(text) <= width:
        return text
    while len(text) > 1 and text_width(text + "\N{HORIZONTAL ELLIPSIS}") > width:
        text = text[:-1]
    return text + "\N{HORIZONTAL ELLIPSIS}"


def legend_rows(handles: Any, width: float, count: int) -> tuple[int, list[str]]:
    """Columns, at most `count`, in which handles fit into a width [in], and their labels."""
    point = _STYLE["legend.fontsize"] / 72
    key_width = (_STYLE["legend.handlelength"] + _STYLE["legend.handletextpad"]) * point
    names = [str(handle.get_label()) for handle in handles]
    for columns in range(min(count, len(names)), 0, -1):
        parts = np.array_split(names, columns)  # as matplotlib does
        gaps = (len(parts) - 1) * _STYLE["legend.columnspacing"] * point + point
        if sum(key_width + max(map(text_width, part)) for part in parts) + gaps <= width:
            return columns, names
    return 1, [shortened(name, width - key_width - point) for name in names]


def legend_above(ax: Any, handles: Any, columns: int = 2) -> float:
    """Put the legend above the axes, where it covers nothing, in as many columns as fit; its height [in]."""
    if not handles:
        return 0.0
    ticks = ax.yaxis.get_major_formatter().format_ticks(ax.get_yticks())
    axis_width = 0.46 + max((text_width(text) for text in ticks), default=0.0)  # ticks and label of the axis
    width = ax.get_position(original=True).width / 0.775 * ax.figure.get_figwidth() - axis_width
    columns, names = legend_rows(handles, width, columns)
    ax.legend(handles, names, loc="lower left", bbox_to_anchor=(0.0, 1.01), ncols=columns, labelspacing=0.3)
    return 0.145 * -(-len(names) // columns)


def dot(marker: str, colour: Any, size: float, name: str, **look: Any) -> Any:
    """A handle of a legend: a marker alone."""
    return Line2D([], [], ls="none", marker=marker, color=colour, ms=size, label=name, **look)


def draw_safe_path(ax: Any, picture: PlotData, path: Array, span: tuple[int, int] | None = None) -> list[int]:
    """Draw the run under Polaris by mode, or the reference without one; the modes drawn."""
    if "polaris" not in picture.flights:
        ax.plot(*path[slice(*(span or (0, len(path))))].T, color=GREY, lw=1.1, ls=DOTS, zorder=4.5)
        return []
    pieces = by_mode(picture, path, span)
    for order, (mode, piece) in enumerate(pieces.items()):
        look = {"lw": 1.5, "zorder": 4 + 0.01 * order, "solid_capstyle": "butt"}
        ax.plot(*piece.T, color=mode_colour(mode), **look)
    return list(pieces)
