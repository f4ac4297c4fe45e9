"""Colours safe for colour-blind readers, no two kinds of thing alike, and names in print and on the page."""

from dataclasses import dataclass

import numpy as np

from ...model.system import LinearSystem

# Okabe and Ito's palette; the paper's orange for U and blue for S are in it.
BLUE, ORANGE, VERMILION = "#0072B2", "#E69F00", "#D55E00"
GREEN, SKY, PURPLE, YELLOW, BLACK = "#009E73", "#56B4E9", "#CC79A7", "#F0E442", "#000000"
RED = "#C0202B"  # unsafe sets: darker than the orange, so that they differ in grey too
GREY = "#767676"
DULL_RED, OLIVE, DARK_OLIVE = "#9C4A50", "#8A7F00", "#6B6200"
"""Covers of other satellites, edges of recoverable sets, and their labels."""

MODE_COLOURS = (BLUE, ORANGE, "#7A1FA2", SKY, "#6B4A0F", "#8FB93A", "#1F3A93", "#4D7A00")
SET_SHADES = ("#9A141D", "#F3A6AB")  # darkest and lightest of unsafe sets that are told apart
INPUT_SHADES = ("#3C3C3C", "#D4D4D4")  # darkest and lightest of inputs

FIRST_COLOURS = BLUE, ORANGE, BLACK, GREEN, PURPLE, VERMILION, SKY
METHOD_COLOURS = (*FIRST_COLOURS, "#6B4A0F", "#8A8A8A", "#B8860B", "#7A1FA2", "#4D7A00")
"""Of the methods of a comparison: S alone and U alone come first, in the colours of S and U."""
METHOD_DASHES = ("solid", "dash", "dot", "dashdot", "longdash")
DEPUTY_COLOURS = (BLUE, VERMILION, PURPLE, BLACK, ORANGE, SKY, "#8C6D1F", "#5B5B5B")
"""One for each deputy; green and red stand for safe and unsafe."""

MARGIN_COLOURS = (BLACK, BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)
"""One for each constraint of a diagram of margins, in turn."""

ANSWERS = {  # name and colour of each answer of a filter of the inspection problem
    0: ("wanted thrust applied", "#BFD7E6"),
    1: ("filtered", ORANGE),
    2: ("no answer satisfies all: violated least", PURPLE),
    3: ("failed: no thrust", RED),
    4: ("backup", GREEN),
    5: ("backup, not proven", RED),
}
BACKUP_MODES = {0: ("primary controller", ORANGE), 1: ("backup controller", BLUE)}


@dataclass(frozen=True)
class Look:
    """Colour of one kind of thing, its name on the page and in print, and the switch for it on the page."""

    colour: str
    name: str
    legend: str
    group: str


LOOKS = {  # by role of an item of a scene
    "unsafe": Look(RED, "keep-out zone", "unsafe", "unsafe"),
    "cover": Look(DULL_RED, "its bounds", "satellite's bounds", "unsafe"),
    "keep_in": Look(RED, "stay inside", "stay inside", "unsafe"),
    "sides": Look(RED, "its sides", "", "unsafe"),
    "goal": Look(GREEN, "goal", "goal", "goal"),
    "ring": Look(GREEN, "goal", "", "goal"),
    "start": Look("#404040", "start", "start", "initial"),
    "initial": Look("#404040", "initial set", "", "initial"),
    "reference": Look(GREY, "safe reference", "reference", "reference"),
    "tail": Look("#B5B5B5", "reference after T", "reference after T", "reference"),
    "slice": Look(YELLOW, "recoverable set", "recoverable sets", "slice"),
    "tube": Look(SKY, "reachable now", "reachable tube", "tube"),
    "chief": Look(RED, "chief: keep-out sphere", "chief", "unsafe"),
    "keep": Look(GREY, "keep-in sphere", "", "keep"),
    "sun": Look(ORANGE, "towards the sun", "", "sun"),
    "predicted": Look(SKY, "backup flights as predicted", "backup flights, predicted", "predicted"),
}

PILOTS = {  # pilots of a run folder: name on the page and in print, colour, dashes on the page
    "polaris": ("Polaris (the schedule)", "Polaris", BLACK, "solid"),
    "safety": ("S alone", "S alone", BLUE, "dash"),
    "experimental": ("U alone", "U alone", ORANGE, "dot"),
}


def mode_colour(mode: int) -> str:
    """Colour of a controller: blue is S, orange the preferred experimental one."""
    return MODE_COLOURS[mode % len(MODE_COLOURS)]


def deputy_colour(deputy: int) -> str:
    """Colour of a deputy."""
    return DEPUTY_COLOURS[deputy % len(DEPUTY_COLOURS)]


def method_style(place: int) -> tuple[str, str]:
    """Colour and dashes of the i-th method: no two of the first fifty are alike."""
    count = len(METHOD_COLOURS)
    dash = METHOD_DASHES[(place // count + place) % len(METHOD_DASHES)]
    return METHOD_COLOURS[place % count], dash


def _rgb(colour: str) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)])


def tint(colour: str, share: float) -> tuple[float, float, float]:
    """The colour mixed with white: opaque, so that overlapping areas do not darken."""
    r, g, b = (1 - share + share * _rgb(colour)).tolist()
    return r, g, b


def shades(ends: tuple[str, str], count: int) -> list[tuple[float, float, float]]:
    """As many colours between two, so that things of one kind differ; the middle one if there is one only."""
    dark, light = map(_rgb, ends)
    places = [0.35] if count == 1 else np.linspace(0, 1, count)
    return [tuple((dark + s * (light - dark)).tolist()) for s in places]


def input_labels(system: LinearSystem) -> tuple[str, tuple[str, ...]]:
    """Return the name of the input, with its unit, and that of each axis."""
    names = tuple(name.removesuffix(" thrust") for name in system.input_names)
    return "Input" if names == system.input_names else "Thrust (N)", names
