"""Values derived from the target's elements or from files of orbits, put into a scenario in their place.

A scenario that is loaded holds numbers alone: the mean motion, how far the target may be off ellipses of it,
elements at the time 0, and the start set. So a run folder needs no other file, and its checker reads what
was flown.
"""

import copy
import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from reach.numerics.files import read_regular
from reach.numerics.packages import unusable

from ..model.errors import ScenarioError
from ..model.keys import printable
from ..model.system import Array
from ..simulation.orbit.environment import EARTH_RADIUS_M, MU, Environment
from ..simulation.orbit.fit import fit_ellipses
from ..simulation.orbit.inertial import elements_of_state, propagate
from ..simulation.orbit.oem import SECOND, Ephemeris, epoch_text, parse_epoch, read_oem
from ..simulation.orbit.residual import residual_bound, two_digits
from ..simulation.orbit.start import start_set
from .reading import validate
from .tables.fields import ScenarioPart, unit
from .tables.orbit import Orbit, OrbitSource, StartSource

MOST_REVOLUTIONS = 20  # longest span that is looked at
FAR_M = 1e8  # largest half major axis
SAMPLES = 500  # states per revolution that an ellipse is put around
REVOLUTIONS = 2  # least number of them that it is put around, if the source goes that far
RADIUS_M, RATE_M_S = 1000.0, 1.0  # how far distance and radial rate may be off the ephemeris by default
TILT_DEG = 0.2  # by which inertial axes and the Earth's axis, and inclinations off an ephemeris, may differ

OLD_DAYS = 14.0  # from the epoch of two-line elements, after which SGP4 is off by tens of kilometres


class _Sources(ScenarioPart):
    """All tables with sources."""

    orbit: OrbitSource = unit("-", default_factory=OrbitSource)
    initial_set: StartSource | None = unit("-", default=None)


class _Orbit(ScenarioPart):
    """The table of the orbit alone, for its messages."""

    orbit: Orbit = unit("-")


@dataclass(frozen=True, eq=False)
class _Path:
    """Inertial states of the target by time [s], epoch of the time 0 [ns], and their source."""

    states: Callable[[Array], Array]
    epoch: int
    frame: str
    time_system: str
    lasts: float
    note: str


def with_sources(
    document: Mapping[str, Any], folder: Path | None, origin: str | None
) -> tuple[Mapping[str, Any], tuple[str, ...]]:
    """Return a scenario's document with numbers in place of sources, and a line on each thing that followed.

    Raises
    ------
    ScenarioError
        If a source is malformed, contradicts another, or does not cover the scenario.
    """
    orbit, start = document.get("orbit", {}), document.get("initial_set")
    if not isinstance(orbit, Mapping):
        return document, ()
    start = start if isinstance(start, Mapping) and start.get("kind") == "ephemeris" else None
    keys = [key for key in OrbitSource.model_fields if key in orbit]
    if not keys and start is None and ("elements" not in orbit or "eccentricity_max" in orbit):
        return document, ()
    tables = {"orbit": {key: orbit[key] for key in keys}, **({} if start is None else {"initial_set": start})}
    sources = validate(_Sources, tables, origin)
    try:
        return _Resolved(copy.deepcopy(dict(document)), folder or Path(), sources, origin).result()
    except ScenarioError as error:
        raise ScenarioError(error.field, error.given, error.rule, error.where or origin) from error


class _Resolved:
    """One document whose sources are read."""

    def __init__(self, document: dict[str, Any], folder: Path, sources: _Sources, origin: str | None) -> None:
        self.document, self.folder, self.source = document, folder, sources.orbit
        self.start, self.origin = sources.initial_set, origin
        self.orbit: dict[str, Any] = document.setdefault("orbit", {})
        for key in OrbitSource.model_fields:
            self.orbit.pop(key, None)
        horizon = document.get("horizon")
        duration = horizon.get("duration_s") if isinstance(horizon, Mapping) else None
        self.duration = float(duration) if isinstance(duration, int | float) and 0 < duration < 1e9 else 0.0
        self.notes: list[str] = []

    def result(self) -> tuple[dict[str, Any], tuple[str, ...]]:
        """Document and notes."""
        chaser = self._file(self.start.ephemeris, "initial_set.ephemeris") if self.start is not None else None
        name = self.source.ephemeris
        target = None if name is None else self._file(name, "orbit.ephemeris")
        if chaser is not None and target is None:
            rule = "must be given with a start set from the chaser's ephemeris"
            raise ScenarioError("orbit.ephemeris", None, rule)
        sources = target, self.source.two_line_elements, self.orbit.get("elements")
        if any(one is not None for one in sources) or self.source.within_m is None:
            path = self._path(target, chaser)
            self._fill(path)
        if self.source.within_m is not None:
            self._allow(self.source.within_m)
        if chaser is not None and target is not None and self.start is not None:
            self._start(target, chaser, path.epoch, self.start)
        return self.document, tuple(self.notes)

    def _file(self, name: str, field: str) -> Ephemeris:
        place = self.folder / name
        try:
            ephemeris = read_oem(place)
        except ScenarioError as error:
            raise ScenarioError(field, name, error.rule) from error
        digest = hashlib.sha256(read_regular(place)).hexdigest()
        self.notes.append(f"{field}: {printable(name)}, SHA-256 {digest}")
        return ephemeris

    def _path(self, target: Ephemeris | None, chaser: Ephemeris | None) -> _Path:
        """Return the target's path from whichever source there is."""
        sources = {
            "orbit.elements": self.orbit.get("elements"),
            "orbit.two_line_elements": self.source.two_line_elements,
            "orbit.ephemeris": target,
        }
        keys = [key for key, value in sources.items() if value is not None]
        if len(keys) != 1:
            rule = "must have one of orbit.elements, orbit.two_line_elements and orbit.ephemeris"
            raise ScenarioError("orbit", keys or None, rule)
        if self.source.epoch is not None and "orbit.elements" in keys:
            raise ScenarioError("orbit.epoch", self.source.epoch, "must be left out: elements have an epoch")
        try:
            epoch = None if self.source.epoch is None else parse_epoch(self.source.epoch)
        except ValueError as error:
            raise ScenarioError("orbit.epoch", self.source.epoch, str(error)) from None
        if target is not None:
            return _of_file(target, chaser, epoch)
        if self.source.two_line_elements is not None:
            return _of_lines(self.source.two_line_elements, epoch)
        return self._of_elements()

    def _of_elements(self) -> _Path:
        env, orbit = self._environment(None)
        elements = orbit.elements
        assert elements is not None
        try:
            epoch = elements.nanoseconds()
        except ValueError as error:
            raise ScenarioError("orbit.elements.epoch", elements.epoch, str(error)) from None
        start = elements.state()
        if not elements.semi_major_axis_m * (1 - elements.eccentricity) > EARTH_RADIUS_M:
            rule = "must have its perigee above the Earth's surface"
            raise ScenarioError("orbit.elements.semi_major_axis_m", elements.semi_major_axis_m, rule)
        env = replace(env, mean_motion=math.sqrt(MU / elements.semi_major_axis_m**3))
        source = "orbit.elements, propagated with J2 and drag"
        frame, time = elements.frame, elements.time_system
        return _Path(lambda times: propagate(env, start, times), epoch, frame, time, math.inf, source)

    def _environment(self, motion: float | None) -> tuple[Environment, Orbit]:
        """Return the table as an environment: missing values are 0."""
        filled = {"radius_deviation_max_m": 0.0, "radial_rate_max_m_s": 0.0, "rate_deviation_max": 0.0}
        table = validate(_Orbit, {"orbit": {**filled, **self.orbit}}, self.origin).orbit
        environment: Environment = table.make("orbit", mean_motion=motion or 1e-3)
        return environment, table

    def _fill(self, path: _Path) -> None:
        """Put everything that follows from the target's path into the document."""
        state = path.states(np.zeros(1))[0]
        a, e, *angles = elements_of_state(state)
        period = 2 * math.pi * math.sqrt(a**3 / MU)
        if not a * (1 - e) > EARTH_RADIUS_M or not a < FAR_M:
            rule = f"must be an orbit of the Earth, above its surface and within {FAR_M:g} m"
            raise ScenarioError("orbit", f"{path.note}: a = {a:g} m, e = {e:g}", rule)
        required = min(max(2 * self.duration, REVOLUTIONS * period), MOST_REVOLUTIONS * period)
        end = min(path.lasts, required)
        if path.lasts < self.duration:
            rule = (
                f"must cover the scenario's {self.duration:g} s from its time 0 on; it ends after {end:g} s"
            )
            raise ScenarioError("orbit", path.note, rule)
        states = path.states(np.linspace(0.0, end, max(2, math.ceil(end / period * SAMPLES))))
        span = f"{end:.0f} s"
        if end < required:
            later = np.linspace(0.0, required - end, math.ceil((required - end) / period * SAMPLES) + 1)
            env = replace(self._environment(None)[0], mean_motion=math.sqrt(MU / a**3))
            states = np.concatenate([states, propagate(env, states[-1], later)])
            span += f" and {required - end:.0f} s beyond its end, propagated with J2 and drag"
        system = self.document.get("system")
        untrusted = system.get("mean_motion_rad_s") if isinstance(system, Mapping) else None
        orbit = self.orbit
        orbit.setdefault("radius_deviation_max_m", RADIUS_M)
        orbit.setdefault("radial_rate_max_m_s", RATE_M_S)
        normal = np.cross(states[:, :3], states[:, 3:])
        tilt = np.degrees(np.arctan2(np.hypot(normal[:, 0], normal[:, 1]), np.abs(normal[:, 2]))).max()
        orbit.setdefault("inclination_max_deg", min(90.0, math.ceil(10 * (float(tilt) + TILT_DEG)) / 10))
        number = untrusted if isinstance(untrusted, float) and 0 < untrusted <= 0.01 else None
        motion, largest, share = fit_ellipses(states, self._environment(None)[0], number)
        orbit.setdefault("eccentricity_max", largest)
        orbit.setdefault("rate_deviation_max", share)
        if isinstance(system, dict) and system.get("kind") == "clohessy_wiltshire":
            system.setdefault("mean_motion_rad_s", motion)
        keys = "ascending_node_deg", "perigee_deg", "true_anomaly_deg"
        orbit.setdefault(
            "elements",
            {
                "epoch": epoch_text(path.epoch),
                "semi_major_axis_m": a,
                "eccentricity": e,
                "inclination_deg": math.degrees(angles[0]),
                **{key: math.degrees(angle) for key, angle in zip(keys, angles[1:], strict=True)},
                "frame": path.frame,
                "time_system": path.time_system,
            },
        )
        self.notes.append(
            f"from {path.note}, over {span}: mean motion {motion:.8g} rad/s, eccentricity up to"
            f" {orbit['eccentricity_max']:g}, rate off by up to {orbit['rate_deviation_max']:g} of it,"
            f" inclination up to {orbit['inclination_max_deg']:g} deg"
        )
        self.notes.append(
            f"assumed of the target besides: within {orbit['radius_deviation_max_m']:g} m and"
            f" {orbit['radial_rate_max_m_s']:g} m/s of that ellipse, for as long as a guarantee is to hold"
        )

    def _allow(self, reach: float) -> None:
        """Let the disturbance bound cover the model error within a distance [m]."""
        system = self.document.get("system")
        eta = system.get("mean_motion_rad_s") if isinstance(system, dict) else None
        if not isinstance(system, dict) or not isinstance(eta, float) or not 0 < eta <= 0.01:
            raise ScenarioError("orbit.within_m", reach, "needs system.mean_motion_rad_s or a source of it")
        if "disturbance_max_m_s2" not in system:
            speed = 2 * reach * max(eta, 1 / self.duration if self.duration else 0.0)
            bound = residual_bound(self._environment(eta)[0], reach, reach, speed)
            system["disturbance_max_m_s2"] = allowed = two_digits(float(bound.total))
            text = f"covers the model error within {reach:g} m at up to {speed:.2g} m/s"
            self.notes.append(f"system.disturbance_max_m_s2: {allowed:g} m/s^2 {text}")

    def _start(self, target: Ephemeris, chaser: Ephemeris, epoch: int, spec: StartSource) -> None:
        """Put the start set into the document."""
        centre, spans, assumption = start_set(
            target, chaser, epoch, spec.sigma, spec.velocity_frame == "rotating"
        )
        self.document["initial_set"] = {
            "kind": "zonotope", "center": centre.tolist(), "generators": spans.T.tolist(),
        }  # fmt: skip
        self.notes.append(assumption)
        description = str(self.document.get("description", "")).rstrip()
        self.document["description"] = f"{description}\n{assumption}.\n".lstrip()


def _of_file(target: Ephemeris, chaser: Ephemeris | None, epoch: int | None) -> _Path:
    if epoch is None:
        epochs = () if chaser is None else sorted(chaser.covariances)
        inside = [one for one in epochs if target.epochs[0] <= one <= target.epochs[-1]]
        epoch = inside[0] if inside else target.epochs[0]
    if not target.epochs[0] <= epoch <= target.epochs[-1]:
        rule = f"must lie in the target's ephemeris, {epoch_text(target.epochs[0])} to"
        raise ScenarioError("orbit.epoch", epoch_text(epoch), f"{rule} {epoch_text(target.epochs[-1])}")
    begin = epoch

    def states(times: Array) -> Array:
        try:
            return target.states_at([begin + round(float(t) * SECOND) for t in times])
        except ScenarioError as error:
            raise ScenarioError("orbit.ephemeris", error.given, error.rule, error.where) from error

    lasts = (target.epochs[-1] - begin) / SECOND
    source = f"orbit.ephemeris ({printable(target.source)})"
    return _Path(states, begin, target.frame, target.time_system, lasts, source)


def _of_lines(lines: tuple[str, str], epoch: int | None) -> _Path:
    """Return the path by SGP4, in TEME."""
    if reason := unusable("sgp4"):
        raise ScenarioError("orbit.two_line_elements", lines[0], reason)
    from sgp4.api import SGP4_ERRORS, Satrec
    from sgp4.io import verify_checksum

    try:
        for number, line in enumerate(lines, 1):
            if len(line) != 69 or line[:2] != f"{number} " or line[2:7] != lines[0][2:7]:
                rule = f"line {number} must have 69 characters, begin with {number} and name one object"
                raise ValueError(rule)
        verify_checksum(*lines)
        satellite = Satrec.twoline2rv(*lines)
    except ValueError as error:
        raise ScenarioError("orbit.two_line_elements", lines[0], printable(str(error))) from None
    year = 2000 + satellite.epochyr if satellite.epochyr < 57 else 1900 + satellite.epochyr
    begin = parse_epoch(f"{year}-001T00:00:00") + round((satellite.epochdays - 1) * 86400e9 / 1000) * 1000
    start = begin if epoch is None else epoch
    if (age := abs(start - begin) / SECOND / 86400) > OLD_DAYS:
        rule = f"must be within {OLD_DAYS:g} days of the elements' {epoch_text(begin)}; it is {age:.0f} away"
        raise ScenarioError("orbit.epoch", epoch_text(start), rule)

    def states(times: Array) -> Array:
        rows = []
        for t in times:
            code, place, velocity = satellite.sgp4_tsince(((start - begin) / SECOND + float(t)) / 60)
            if code:
                raise ScenarioError("orbit.two_line_elements", lines[0], f"SGP4 says: {SGP4_ERRORS[code]}")
            rows.append([*place, *velocity])
        return np.array(rows) * 1e3

    return _Path(states, start, "TEME", "UTC", math.inf, "orbit.two_line_elements by SGP4")
