"""Plot data of flights over time, as the page's script reads them.

A pilot is one controller, method or spacecraft with the runs of it that can be shown:
``{key, name, colour, dash, on, labels, t, runs: [{p, modes}]}``, where ``p`` are the coordinates by axis and
``modes`` who flies from each sample on.

A panel is one diagram: ``{key, title, unit, limits, series}``. A series belongs to a pilot (``pilot``) or
to none, and has ``y`` (one line) or ``runs`` (a line per run of its pilot), samples ``t`` if they are not
the pilot's, ``step`` if it is held until the next sample, and perhaps a ``band`` of two lines.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from reach.numerics.linear import growth

from ...model.scene.distances import UNKNOWN, signed_distances
from ...model.scene.obstacles import perceive
from ...model.system import Array
from ...model.tolerances import ROUNDING
from ...runs.picture import Picture
from ...simulation.baselines import Flights
from ...synthesis.safety.recoverable import directed
from ..scene.items import modes_per_node
from ..scene.palette import GREEN, input_labels, mode_colour
from ..scene.scene import describe, shown_axes
from .scene import plain, scene_data

MOST = 400  # most samples of a run that are drawn, besides changes of controller
WHO = "Who flies"
ROUND_OFF = 1e-9  # inputs below this share of the limit are 0 but for rounding

Drawn = tuple[str, Array, Array | None]
"""Key of a pilot, inputs of its runs (r, N, m), and least and largest over all runs (2, N, m) if known."""


class Flown(NamedTuple):
    """Controller that flew, its look (``colour``, ``dash``, ``on`` at first), and its runs."""

    key: str
    name: str
    look: dict[str, Any]
    runs: Flights


def flight_data(
    picture: Picture, flown: Sequence[Flown], proved: bool, by: str, opened: float | None = None
) -> dict[str, Any]:
    """Return the plot data of a schedule and its pilots, coloured by ``mode`` or ``pilot``.

    The distance that is proven is shown if there is a proof. The page opens at `opened` [s], by default the
    closest approach.
    """
    C = picture.system.position
    paths = [one.runs.states[0] @ C.T for one in flown]
    scene = describe(picture, paths, shown_axes(picture, paths))
    pilots, distances, drawn, spent = [], [], [], []
    for one in flown:
        runs, t, modes = one.runs, one.runs.times, modes_per_node(one.runs)
        chosen = kept(len(t), modes, [int(np.argmin(runs.nearest[0]))])
        held, positions = np.minimum(chosen, runs.inputs.shape[1] - 1), runs.states @ C.T
        who = modes[:, np.minimum(chosen[:-1], modes.shape[1] - 1)]
        places = scene.placed(positions[:, chosen], t[chosen])
        pilots.append(pilot(one.key, one.name, runs.labels, t[chosen], places, who) | one.look)
        if picture.obstacles:  # other satellites are where they are nominally: no file says where they were
            found = signed_distances(picture.obstacles, t, positions, picture.system).min(axis=0)
            band = runs.nearest[[0, 2]][:, chosen]
            distances.append({"pilot": one.key, "runs": plain(found[:, chosen]), "band": plain(band)})
        spent.append({"pilot": one.key, "runs": plain(picture.velocity_change(runs)[:, chosen])})
        span = None if runs.input_range is None else runs.input_range[:, held]
        drawn.append((one.key, runs.inputs[:, held], span))
    bound = proven_distance(picture) if proved else None
    if bound is not None:
        distances.append(_proven(bound, picture.reference.delta))
    label, names = input_labels(picture.system)
    what, _, unit = label.rstrip(")").partition(" (")
    titles = [f"{what}, {name}" if what != "Input" else f"Input: {name}" for name in names]
    panels = [
        _margins(picture),
        _spent(picture.delta_v_max if proved else None, spent),
        *input_panels(titles, unit, picture.system.u_max, drawn),
    ]
    if picture.obstacles:
        title = "Distance to the nearest unsafe set"
        panels.insert(0, panel("distance", title, "m", [limit(0.0, "unsafe", "below")], distances))
    present = np.concatenate([picture.modes, *(np.ravel(one.runs.modes) for one in flown)])
    opened = picture.closest if opened is None else opened
    return {
        "scene": scene_data(scene),
        "end": max((one["t"][-1] for one in pilots), default=plain(opened)),
        "open": plain(opened),
        "modes": modes_present(present, partial(_named, picture)),
        "modes_title": WHO,
        "by": by,
        "marks": [{"t": plain(picture.reached), "text": picture.arrival}]
        if proved and picture.reached
        else [],
        "pilots": pilots,
        "panels": panels,
    }


def _named(picture: Picture, mode: int) -> tuple[str, str]:
    """Name and colour of who flies."""
    if mode == UNKNOWN:
        return "filtered input, or not known", "#9A9A9A"
    known = 0 <= mode < len(picture.controllers)
    return picture.mode_name(mode) if known else f"controller {mode}", mode_colour(mode)


def kept(count: int, modes: ArrayLike = (), must: Sequence[int] = ()) -> NDArray[np.intp]:
    """Samples of `count` that are drawn: evenly many, the ends, changes of modes (r, N-1), what must be."""
    if count <= MOST:
        return np.arange(count)
    even = np.linspace(0, count - 1, MOST).astype(int)
    changes = np.flatnonzero(np.diff(np.atleast_2d(modes), axis=1).any(axis=0)) + 1
    if len(changes) > MOST:  # nobody could see them all
        changes = changes[:: -(-len(changes) // MOST)]
    return np.unique(np.concatenate([even, changes, must]).astype(int))


def pilot(
    key: str, name: str, labels: Sequence[str], t: Array, paths: Array, modes: NDArray[np.int_]
) -> dict[str, Any]:
    """One pilot at times (N,) [s]: paths (r, N, dim) in the axes of the scene [m], who flies (r, N-1)."""
    runs = [{"p": plain(path.T), "modes": plain(who)} for path, who in zip(paths, modes, strict=True)]
    return {"key": key, "name": name, "labels": list(labels), "t": plain(t), "runs": runs}


def modes_present(present: ArrayLike, named: Callable[[int], tuple[str, str]]) -> list[dict[str, Any]]:
    """Name and colour of every mode that occurs."""
    keys = ("mode", "name", "colour")
    return [dict(zip(keys, (mode, *named(mode)), strict=True)) for mode in np.unique(present).tolist()]


def limit(y: float, text: str, unsafe: str = "") -> dict[str, Any]:
    """A limit in a panel; `unsafe` says which side of it is shaded: ``above``, ``below`` or none."""
    return {"y": plain(y), "text": text, "unsafe": unsafe}


def panel(key: str, title: str, unit: str, limits: list[dict[str, Any]], series: list[Any]) -> dict[str, Any]:
    """One diagram."""
    unit = unit.replace("^2", "²")
    return {"key": key, "title": title, "unit": unit, "limits": limits, "series": series}


def input_panels(
    titles: Sequence[str], unit: str, most: ArrayLike, drawn: Sequence[Drawn]
) -> list[dict[str, Any]]:
    """One panel per input, between its limits."""
    found = []
    for axis, (title, end) in enumerate(zip(titles, np.asarray(most).tolist(), strict=True)):
        series = [
            {"pilot": key, "step": True, "runs": plain(_rounded(inputs[..., axis], end))}
            | ({} if span is None else {"band": plain(span[..., axis])})
            for key, inputs, span in drawn
        ]
        limits = [limit(-end, "", "below"), limit(end, f"limit {end:.4g}", "above")]
        found.append(panel(f"input{axis}", title, unit, limits, series))
    return found


def _rounded(values: Array, most: float) -> Array:
    """Inputs, those that are 0 but for rounding as 0."""
    return np.where(np.abs(values) < ROUND_OFF * most, 0.0, values)


def _spent(most: float | None, series: list[Any]) -> dict[str, Any]:
    """Velocity change so far, and what is proven of it."""
    told = f"proven until the goal: at most {directed(most, '.4g', up=True)}" if most else ""
    return panel("spent", "Velocity change so far", "m/s", [limit(most, told)] if most else [], series)


def _margins(picture: Picture) -> dict[str, Any]:
    """Room left in the recoverable sets, step by step."""
    delta = picture.reference.delta
    told = zip(picture.margins, picture.limits, strict=True)
    series = {
        "pilot": None,
        "name": "margin",
        "bars": True,
        "t": plain((np.arange(len(picture.modes)) + 0.5) * delta),
        "width": plain(delta),
        "y": plain(picture.margins),
        "modes": plain(picture.modes),
        "text": [f"margin {directed(share, '.3f')}, limit: {name}" for share, name in told],
    }
    title = "Containment margin of each step of the schedule"
    return panel("margin", title, "share of room", [limit(0.0, "")], [series])


def _proven(bound: Array, delta: float) -> dict[str, Any]:
    """The distance that is proven, held over every period."""
    K, q = bound.shape
    times = np.append((np.arange(K)[:, None] + np.arange(q) / q).ravel(), K) * delta
    line = {"t": plain(times), "y": plain(np.append(bound.ravel(), bound[-1, -1])), "step": True}
    look = {"colour": GREEN, "dash": "solid", "fill": True}
    return {"pilot": None, "name": "least that is proven for the schedule"} | line | look


def proven_distance(picture: Picture) -> Array | None:
    """Least distance (K, q) [m] from all unsafe sets that a proved schedule promises over every period.

    The tube lies in the hull of its ends, up to its bow and that of the reference; offsets run linearly, so
    the gap to a facet is least at an end. Negative gaps rest on S taking over: no more than 0 is promised.
    What the true state is displaced by is in the tube, and in the sets that are perceived: it counts once.
    """
    tube, system = picture.tube, picture.system
    unsafe = perceive(picture.obstacles, system, picture.reference.delta, picture.planned)
    if tube is None or not unsafe:
        return None
    q, K, reference = tube.bow.shape[1], picture.planned, picture.reference
    rate = reference.fine(q)[:K, :-1] @ system.A.T + (reference.nu[:K] @ system.B.T)[:, None, :]
    grown = np.abs(rate) @ growth(system.A, reference.delta / q).T
    bow = tube.bow + (reference.delta / q) ** 2 / 8 * grown @ np.abs(system.position @ system.A).T
    found, twice = [], np.stack([system.displaced_at_nodes, system.displaced - system.displaced_at_nodes])
    for timed in unsafe:
        rows, offsets = timed.normals, timed.fine(q)
        reach = np.abs(np.einsum("fd,kqdg->kqfg", rows, tube.generators)).sum(axis=-1)
        size = np.abs(tube.centre).sum(axis=-1, keepdims=True) + np.abs(offsets)
        gap = tube.centre @ rows.T - reach - offsets - ROUNDING * size
        apart = np.abs(rows @ system.position) @ twice[0] + np.abs(rows) @ np.abs(system.position) @ twice[1]
        between = np.minimum(gap[:, :-1], gap[:, 1:]) - bow @ np.abs(rows).T + apart
        found.append(between.max(axis=-1))
    return np.asarray(np.maximum(np.min(found, axis=0), 0.0))
