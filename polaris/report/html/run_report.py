"""The page of an ordinary run folder, and guarantees in words: what is proven, how far, on what grounds."""

from collections.abc import Mapping, Sequence
from itertools import groupby
from operator import itemgetter
from typing import Any

import numpy as np
from markupsafe import Markup

from ...model.checks import counted
from ...model.scene.distances import stretches
from ...model.scene.obstacles import perceive
from ...runs.files.folder import RunFolder
from ...runs.files.tables import besides
from ...runs.plot_data import PlotData
from ...synthesis.safety.recoverable import directed
from ..scene.items import Actor, drawn_pilots
from ..scene.palette import mode_colour
from ..scene.scene import describe, shown_axes
from ..scene.timelines import schedule_timeline
from ..sentences import goal, no_time_after_end, reach, side_words, synthesis
from ..tables import Cell, Measure, Table, metrics
from .page import Page, badge, macros, reading, table
from .scene import plain
from .timelines import page_data

CAPTION = "From simulated runs, under random and worst-case disturbances"
MOST_LISTED = 3  # most stretches under S that are listed one by one

NOTE = (
    "Drawn paths keep at most 400 samples of a run; the tables use all of them. Bands cover all simulated "
    "runs, lines are the run shown. The distance of the run shown is to the nominal positions of other "
    "satellites, the band is to their true positions."
)
SLICE = (
    "The recoverable set (yellow) is a slice through the state of the run shown, at the time written beside "
    "it: filled at that time, dashed until the next one."
)


def run_page(folder: RunFolder) -> Page:
    """The report of a run folder."""
    summary = folder.summary
    claim = summary["guarantee"]
    proved = claim["kind"] == "proved"
    picture = folder.plot_data()
    rows = [[Cell(head), Cell(sentence)] for head, sentence in synthesis(summary)]
    return Page(
        str(summary["title"]),
        answers(summary, picture),
        (
            ("numbers", "Metrics", table(metrics(summary, CAPTION))),
            ("guarantee", "The guarantee", guarantee_section(claim) + aborts(claim)),
            ("synthesis", "Synthesis", table(Table("Before the flight", ["", ""], rows))),
            reading(summary, f"{NOTE} {SLICE}"),
        ),
        schedule_data(picture, drawn_pilots(picture), proved),
        summary,
    )


def schedule_data(
    picture: PlotData, controllers: Sequence[Actor], proved: bool, **options: Any
) -> dict[str, Any]:
    """Return the plot data of a schedule and its pilots; see `schedule_timeline`."""
    C = picture.system.position
    paths = [one.flights.states[0] @ C.T for one in controllers]
    scene = describe(picture, paths, shown_axes(picture, paths))
    data = page_data(scene, schedule_timeline(picture, controllers, proved, **options), C)
    data["panels"].insert(min(len(picture.obstacles), 1), _margins(picture))
    return data


def _margins(picture: PlotData) -> dict[str, Any]:
    """Return the diagram of the clearance left in the recoverable sets: a bar per step, by who flies."""
    delta, pairs = picture.reference.delta, zip(picture.margins, picture.limits, strict=True)
    sets = (*picture.obstacles, *picture.state_limits)
    words = side_words(perceive(sets, picture.system, delta, picture.planned), picture.system)
    text = [f"margin {directed(share, '.3f')}, limit: {words.get(name, name)}" for share, name in pairs]
    series: dict[str, Any] = {"pilot": None, "name": "margin", "bars": True, "text": text}
    series |= {"t": plain((np.arange(len(picture.modes)) + 0.5) * delta), "width": plain(delta)}
    series |= {"y": plain(picture.margins), "modes": plain(picture.modes)}
    title, limits = "Margin of each step of the schedule", [{"y": 0, "text": "", "unsafe": ""}]
    panel = {"key": "margin", "title": title, "unit": "share of clearance"}
    return panel | {"limits": limits, "series": [series]}


def answers(summary: Mapping[str, Any], picture: PlotData) -> Markup:
    """The first screen: safety, arrival, cost, and the controller of each step."""
    claim, flights, search = summary["guarantee"], summary["polaris"], summary["synthesis"]
    end, proved = claim["goal"], claim["kind"] == "proved"
    within, delta_v = (directed(end[key], ".4g", up=True) for key in ("distance_m", "delta_v_max_m_s"))
    arrives = ("no claim", "the guarantee is not proved")
    cost = f"mean of {counted(flights['runs'], 'simulated run')}"
    if proved:
        word = "not proven" if end["reached"] == "not_proven" else "no"
        cause = no_time_after_end(claim)
        near = f"at best within {within} m; the tolerance is {end['tolerance_m']:.4g} m"
        arrives = (word, near + f"; {cause}" * bool(cause))
        if end["reached"] is True:
            near = f"proven, within {within} m of the goal (the tolerance is {end['tolerance_m']:.4g} m)"
            arrives = (f"at {_time(end['by_s'])}", f"{near}; S must fly on to stay there")
        endpoint = "to the goal" if end["reached"] is True else "until it is nearest"
        cost += f"; proven {endpoint}: at most {delta_v} m/s"
    if "safety" in summary:
        cost += "; S alone " + Measure.from_key("delta_v_m_s").text(summary["safety"]["delta_v_m_s"])
    share = Measure.from_key("experimental_share").text(search["experimental_share"])
    switches = search["switches"]
    cards = (
        ("Is it safe?", badge(claim["kind"]), reach(claim) if claim["kind"] != "none" else "no claim"),
        ("Does it arrive?", *arrives),
        ("What does it cost?", Measure.from_key("delta_v_m_s").text(flights["delta_v_m_s"]), cost),
        ("Who flies when?", "U " + share, f"{counted(switches, 'switch', 'switches')}; {_spans(picture)}"),
    )
    runs = [(len(list(stretch)), mode_colour(mode)) for mode, stretch in groupby(picture.modes.tolist())]
    return Markup(macros("run.html").answers(cards, runs, _time(picture.duration)))


def _time(t: float) -> str:
    return f"{t:.6g} s"


def _spans(picture: PlotData) -> str:
    """Describe the times at which S flies."""
    delta, spans = picture.reference.delta, stretches(picture.modes == 0)
    if len(spans) > MOST_LISTED:
        return f"S in {len(spans)} stretches"
    return "S " + (", ".join(f"{a * delta:.6g} to {_time(b * delta)}" for a, b in spans) or "never")


def guarantee_section(claim: Mapping[str, Any]) -> Markup:
    """The section of an ordinary run folder, from ``summary.json``."""
    rows = [("Goal", goal(claim)), *besides(claim)] if claim["kind"] == "proved" else []
    arrival = claim["goal"]["reached"] is True, no_time_after_end(claim)
    return Markup(macros("run.html").guarantee(claim, badge(claim["kind"]), reach(claim), *arrival, rows))


def aborts(claim: Mapping[str, Any]) -> Markup:
    """Return the table of aborts with thrust; steps with one branch and time, or one failure, share a row."""
    rows, abort_steps = [], claim.get("powered_abort", {}).get("steps", ())
    for (leaves, by, why), group in groupby(abort_steps, itemgetter("leaves_s", "by_s", "why")):
        steps = list(group)
        delta_v = max((each["delta_v_m_s"] for each in steps if why is None), default=0.0)
        cost = why or f"{directed(delta_v, '.4g', up=True)} m/s"
        cells = f"{steps[0]['step']} to {steps[-1]['step']}", *(("", "") if why else map(_time, (leaves, by)))
        rows.append([Cell(text) for text in (*cells, cost)])
    heads = ["in steps", "leaves the reference", "on the orbit by", "delta-v at most, or reason for none"]
    return table(Table("Abort with thrust", heads, rows)) if rows else Markup()
