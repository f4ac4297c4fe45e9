"""Reference, branches and flights of a run folder as ephemerides in inertial axes (CCSDS OEM)."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ...certificate.files.document import read
from ...model.errors import ScenarioError
from ...model.system import Array
from ...planning.reference import Reference
from ...scenario.schedule import ScheduleScenario
from ...simulation.orbit.environment import Environment
from ...simulation.orbit.inertial import from_hill, propagate
from ...simulation.orbit.oem import Track, oem_lines
from ..read_schedule import NAME, schedule_folder
from .arrays import read_flights
from .atomic import adding
from .folder import readable
from .tables import read_reference, write_text

FOLDER = "oem"
APART_S = 10.0  # longest time between states: Hermite's cubic is then within 1 mm of the flight between them

INERTIAL = "Inertial velocities; those in Hill's frame are of an observer who turns with it."


def export_oem(folder: str | Path) -> list[Path]:
    """Write the orbits of a run folder into its folder ``oem``, one file for each.

    The target's own orbit is integrated from its elements with J2 and drag. Every other craft is where its
    states in Hill's frame put it; their velocities are those in the frame that turns with the target.

    Parameters
    ----------
    folder : path
        Run folder of a schedule, whose scenario has ``[orbit.elements]``.

    Returns
    -------
    list of Path
        ``target.oem``, ``reference.oem``, one for each reference of an abort, one for each flight kept.

    Raises
    ------
    ScenarioError
        If it is no such folder, or the scenario has no elements.
    """
    run = schedule_folder(folder)
    scenario: ScheduleScenario = run.scenario
    orbit = scenario.model.orbit
    if orbit is None or orbit.elements is None:
        rule = "must be given: inertial frames need the target's orbit and its epoch (see Real orbits)"
        raise ScenarioError("orbit.elements", None, rule, str(run.path))
    env, elements = Environment.from_scenario(scenario), orbit.elements
    with readable(run.path):
        tracks = [*_tracks(run.path, scenario)]
    # One integration over whole nanoseconds: equal epochs have equal states of the target in all files.
    times = np.unique(np.round(np.concatenate([track.times for track in tracks]), 9))
    target = propagate(env, elements.state(), times)
    written = [Track("target", times, target, "The target, integrated from its elements with J2 and drag.")]
    for track in tracks:
        target_states = target[np.searchsorted(times, np.round(track.times, 9))]
        comment = f"{track.comment} {INERTIAL}"
        written.append(Track(track.name, track.times, from_hill(target_states, track.states), comment))
    with adding(run.path, FOLDER) as place:
        for track in written:
            lines = oem_lines(track, elements.nanoseconds(), elements.frame, elements.time_system)
            write_text(place / f"{track.name}.oem", "\n".join(lines) + "\n")
    return [run.path / FOLDER / f"{track.name}.oem" for track in written]


def _tracks(path: Path, scenario: ScheduleScenario) -> Iterator[Track]:
    """States in Hill's frame of everything that a run folder holds."""
    system, delta = scenario.system(), scenario.step
    reference = read_reference(path / "reference.csv", system, delta)
    yield Track("reference", *_fine(reference, 0), "Reference of the schedule, coasting at its end.")
    powered = read(path / NAME).powered
    for branch in () if powered is None else powered.branches:
        inputs = np.array([[float(u) for u in row] for row in branch.inputs]).reshape(-1, system.m)
        departure = Reference.propagate(system, delta, reference.chi[branch.step], inputs)
        departure = departure.extend(max(len(branch.facets) - branch.step - len(inputs), 0))
        comment = f"Reference of an abort from step {branch.step} on."
        yield Track(f"branch-{branch.step}", *_fine(departure, branch.step), comment)
    for controller, flights in read_flights(path / "trajectories.npz").items():
        for label, states in zip(flights.labels, flights.states, strict=True):
            comment = f"Simulated flight {label} of {controller} by the linear model."
            yield Track(f"{controller}-{label.replace(' ', '-')}", flights.times, states, comment)


def _fine(reference: Reference, first: int) -> tuple[Array, Array]:
    """Times (N,) [s] and states (N, 6) of a reference from a step on, close enough to interpolate between."""
    parts = int(np.ceil(reference.delta / APART_S))
    states = reference.fine(parts)
    times = (first + np.arange(reference.cells * parts + 1) / parts) * reference.delta
    return times, np.vstack([states[:, :-1].reshape(-1, states.shape[-1]), states[-1, -1:]])
