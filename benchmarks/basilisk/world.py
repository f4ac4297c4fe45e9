"""Two spacecraft in Basilisk: gravity with J2, drag, thrusters with on-times, noisy navigation.

Equations of motion, integrator, atmosphere, drag, thrusters and the noise of navigation are Basilisk's. From
the toolkit come the scenario's numbers and the target's first state. Modules are called where something
changes: at every control period, the chaser's also whenever a nozzle opens or shuts, both craft's when
navigation is asked.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from Basilisk.architecture import messaging
from Basilisk.simulation import (
    dragDynamicEffector,
    exponentialAtmosphere,
    gravityEffector,
    simpleNav,
    spacecraft,
    sphericalHarmonicsGravityModel,
    thrusterDynamicEffector,
)
from Basilisk.utilities import RigidBodyKinematics, SimulationBaseClass, macros

from polaris.simulation.orbit.environment import EARTH_RADIUS_M, J2, MU, Environment

from .onboard import FlightSoftware
from .valves import EXACT, Stuck

SIGNS = np.cross(np.eye(3)[:, None], np.eye(3)).transpose(2, 0, 1)
"""Signs of products of components in a cross product."""

LOGGED = "seen", "shown", "asked", "impulse", "spread", "pushed"
"""Values that are kept of every control period."""

DRAG = 2.2
"""Drag coefficient; areas follow from the scenario's ballistic coefficients."""


@dataclass(frozen=True)
class Errors:
    """Errors of one flight's hardware: constant over the flight, drawn within the scenario's bounds."""

    position: float = 0.0  # largest error of navigation along an axis [m]
    velocity: float = 0.0  # [m/s]
    thrust: tuple[float, ...] = (1.0,) * 6  # share of its thrust that each direction gives: +x, -x, +y, ...
    tilt: tuple[float, float, float] = (0.0, 0.0, 0.0)  # rotation vector of the thrusters' frame [rad]
    mass: float = 1.0  # true mass over that of the model


@dataclass(frozen=True)
class Flight:
    """Record of one flight, at every control period.

    Attributes
    ----------
    times : ndarray, shape (P+1,)
    states : ndarray, shape (P+1, 6)
        True relative states in the target's frame [m, m/s].
    seen, shown : ndarray, shape (P, 6)
        Estimates of navigation in every control period, and the true states then.
    asked : ndarray, shape (P, 3)
        Commands of the flight software at every control period [N].
    impulse, spread : ndarray, shape (P, 3)
        Of every period's pulses, all centred in it: their true impulse [N s], and their second moment in time
        about the middle [N s^3], in that frame.
    """

    times: np.ndarray
    states: np.ndarray
    seen: np.ndarray
    shown: np.ndarray
    asked: np.ndarray
    impulse: np.ndarray
    spread: np.ndarray
    pushed: np.ndarray  # impulses of all nozzles together in every period, (P,) [N s]


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross product of vectors (..., 3); for single ones several times as fast as numpy's."""
    return np.asarray(np.einsum("ijk,...j,...k->...i", SIGNS, a, b))


def frame(r: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Hill's frame of inertial positions and velocities (..., 3): its axes as rows, its rate in them.

    Shapes (..., 3, 3) and (..., 3). J2 alone is taken to turn the orbit's plane.
    """
    h = cross(r, v)
    size, R = np.linalg.norm(h, axis=-1), np.linalg.norm(r, axis=-1)
    x, z = r / R[..., None], h / size[..., None]
    axes = np.stack([x, cross(z, x), z], axis=-2)
    across = -3 * J2 * MU * EARTH_RADIUS_M**2 / R**4 * x[..., 2] * z[..., 2]
    return axes, np.stack([R * across / size, np.zeros_like(R), size / R**2], axis=-1)


def relative(
    target: np.ndarray, chaser: np.ndarray, hill: tuple[np.ndarray, np.ndarray] | None = None
) -> np.ndarray:
    """State of the chaser in the target's frame, which may be known, from inertial states (..., 6)."""
    axes, rate = frame(target[..., :3], target[..., 3:]) if hill is None else hill
    p = np.einsum("...ij,...j->...i", axes, chaser[..., :3] - target[..., :3])
    v = np.einsum("...ij,...j->...i", axes, chaser[..., 3:] - target[..., 3:])
    return np.concatenate([p, v - cross(rate, p)], axis=-1)


def absolute(target: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Inertial state of the chaser, from its state in the target's frame."""
    axes, rate = frame(target[:3], target[3:])
    return target + np.concatenate([x[:3] @ axes, (x[3:] + cross(rate, x[:3])) @ axes])


def inertial(env: Environment, latitude: float, target: np.ndarray) -> np.ndarray:
    """Inertial state of a target as `polaris.simulation.orbit.frame` gives it, node on the x axis."""
    R, V, h, px, py, pz = target
    inclination = np.arctan2(np.hypot(px, py), pz)
    c, s = np.cos(latitude), np.sin(latitude)
    ci, si = np.cos(inclination), np.sin(inclination)
    radial, along = np.array([c, s * ci, s * si]), np.array([-s, c * ci, c * si])
    return np.concatenate([R * radial, V * radial + h / R * along])


class Computer:
    """Runs the flight software, and the valves: navigation in, on-times of the nozzles out."""

    def __init__(self, software: FlightSoftware, navigators: list[Any], craft: list[Any]) -> None:
        self.software = software
        self.navigators = [messaging.NavTransMsgReader() for _ in navigators]
        self.craft = [messaging.SCStatesMsgReader() for _ in craft]
        for reader, nav in zip(self.navigators, navigators, strict=True):
            reader.subscribeTo(nav.transOutMsg)
        for reader, body in zip(self.craft, craft, strict=True):
            reader.subscribeTo(body.scStateOutMsg)
        self.output = messaging.THRArrayOnTimeCmdMsg()
        self.latest: Any = None
        self.log: dict[str, list[Any]] = {each: [] for each in LOGGED}

    def measure(self) -> None:
        """Ask navigation, which has its errors, for the relative state now."""
        estimates, true = (
            [np.concatenate([message.r_BN_N, message.v_BN_N]) for message in (reader() for reader in readers)]
            for readers in (self.navigators, self.craft)
        )
        hill = frame(true[0][:3], true[0][3:])
        self.latest = relative(*estimates, hill)
        self.log["seen"].append(self.latest)
        self.log["shown"].append(relative(*true, hill))

    def burns(self, tick: int) -> tuple[np.ndarray, np.ndarray]:
        """Return on-times of all nozzles [s] in the period that begins, and the attitude in Hill's frame."""
        target, chaser = (each() for each in self.craft)
        hill = frame(np.array(target.r_BN_N), np.array(target.v_BN_N))
        force = self.software.command(tick, self.latest)
        attitude = RigidBodyKinematics.MRP2C(np.array(chaser.sigma_BN)) @ hill[0].T
        self.log["asked"].append(force)
        return self.software.on_times(attitude @ force), attitude

    def open(self, windows: list[tuple[int, float, float]], elapsed: float, instant: int) -> None:
        """Command the nozzles that burn some time [s] into the period, for as long as they still do."""
        on_times = [0.0] * len(self.software.nozzles)
        for nozzle, begins, ends in windows:
            if begins - EXACT < elapsed < ends - EXACT:
                on_times[nozzle] = ends - elapsed
        payload = messaging.THRArrayOnTimeCmdMsgPayload()
        payload.OnTimeRequest = on_times
        self.output.write(payload, instant, 0)


def gravity() -> Any:
    """Return the Earth with its second zonal harmonic alone."""
    planet = gravityEffector.GravBodyData()
    planet.planetName, planet.isCentralBody = "earth_planet_data", True
    planet.mu, planet.radEquator = MU, EARTH_RADIUS_M
    model = sphericalHarmonicsGravityModel.SphericalHarmonicsGravityModel()
    model.radEquator, model.muBody, model.maxDeg = EARTH_RADIUS_M, MU, 2
    model.cBar = [[1.0], [0.0, 0.0], [-J2 / np.sqrt(5.0), 0.0, 0.0]]
    model.sBar = [[0.0], [0.0, 0.0], [0.0, 0.0, 0.0]]
    planet.gravityModel = model
    return planet


def fly(
    software: FlightSoftware,
    env: Environment,
    mass: float,
    bodies: tuple[np.ndarray, np.ndarray],
    area: tuple[float, float],
    errors: Errors,
    duration: float,
    seed: int,
    stuck: Stuck | None = None,
    warm: int = 0,
) -> Flight:
    """One flight from the inertial states of target and chaser.

    `area` are their drag coefficients times area over mass [m^2/kg]. The flight begins `warm` periods before
    tick 0, from which on it is recorded.
    """
    simulation = SimulationBaseClass.SimBaseClass()
    process = simulation.CreateNewProcess("flight")
    process.addTask(simulation.CreateNewTask("all", macros.sec2nano(software.period)))
    planet, air = gravity(), exponentialAtmosphere.ExponentialAtmosphere()
    air.planetRadius, air.baseDensity, air.scaleHeight = env.radius, env.density, env.scale_height
    air.envMinReach, air.envMaxReach = -1e6, 1e6
    axes, rate = frame(bodies[0][:3], bodies[0][3:])
    craft = []
    for state, weight, ballistic in zip(bodies, (mass, mass * errors.mass), area, strict=True):
        body = spacecraft.Spacecraft()
        body.ModelTag = f"craft {len(craft)}"
        body.hub.mHub, body.hub.IHubPntBc_B = weight, (np.eye(3) * weight / 60).tolist()
        body.hub.r_CN_NInit, body.hub.v_CN_NInit = state[:3].tolist(), state[3:].tolist()
        body.hub.sigma_BNInit = [[x] for x in RigidBodyKinematics.C2MRP(axes)]
        body.hub.omega_BN_BInit = [[w] for w in rate]
        body.gravField.gravBodies = spacecraft.GravBodyVector([planet])
        air.addSpacecraftToModel(body.scStateOutMsg)
        drag = dragDynamicEffector.DragDynamicEffector()
        drag.coreParams.projectedArea, drag.coreParams.dragCoeff = ballistic * weight / DRAG, DRAG
        drag.coreParams.comOffset = [0.0, 0.0, 0.0]
        drag.atmoDensInMsg.subscribeTo(air.envOutMsgs[-1])
        body.addDynamicEffector(drag)
        craft.append((body, drag))
    thrusters = thrusterDynamicEffector.ThrusterDynamicEffector()
    turn = RigidBodyKinematics.PRV2C(np.array(errors.tilt)) if np.any(errors.tilt) else np.eye(3)
    true = software.nozzles @ turn * np.array(errors.thrust)[:, None]
    strength = np.linalg.norm(true, axis=1)
    for force in true:
        one = thrusterDynamicEffector.THRSimConfig()
        one.MaxThrust = float(np.linalg.norm(force))
        one.thrLoc_B, one.thrDir_B = [[0.0]] * 3, [[x] for x in force / one.MaxThrust]
        one.MinOnTime, one.steadyIsp, one.cutoffFrequency, one.areaNozzle = 0.0, 1e9, 1e6, 1e-4
        thrusters.addThruster(one)
    body = craft[1][0]
    body.addDynamicEffector(thrusters)
    navigators = []
    for i, (one, *_) in enumerate(craft):
        nav = simpleNav.SimpleNav()
        nav.ModelTag = f"navigation {i}"
        nav.scStateInMsg.subscribeTo(one.scStateOutMsg)
        if i == 1 and (errors.position > 0 or errors.velocity > 0):
            # In inertial axes, which turn against the frame; the walk oversteps its bounds by a little.
            bounds = np.zeros(18)
            bounds[:3], bounds[3:6] = 0.95 * errors.position / 3**0.5, 0.95 * errors.velocity / 3**0.5
            nav.walkBounds = [[b] for b in bounds]
            nav.PMatrix = np.diag(bounds / 3).tolist()
            nav.crossTrans = False
            nav.RNGSeed = seed + 1
        navigators.append(nav)
    computer = Computer(software, navigators, [one for one, _ in craft])
    thrusters.cmdsInMsg.subscribeTo(computer.output)
    logs = [one.scStateOutMsg.recorder() for one, _ in craft]
    arriving = [*logs, air, *(drag for _, drag in craft)]
    for model in (*arriving, *navigators, thrusters, *(one for one, _ in craft)):
        simulation.AddModelToTask("all", model)
    simulation.InitializeSimulation()
    periods, h = round(duration / software.period), software.period
    stuck = stuck or Stuck("stuck_off", 0, np.inf, 0)
    for tick in range(-warm, periods + 1):
        begin = macros.sec2nano((tick + warm) * h)
        for model in arriving:
            model.UpdateState(begin)
        if tick == periods:
            break
        if software.since == 0:
            navigate(computer, navigators, begin)
        if tick == stuck.isolated and np.isfinite(stuck.begins):
            software.isolate(stuck.kind, stuck.nozzle)
        on, attitude = computer.burns(tick)
        windows = stuck.windows(tick, h, on)
        moments = np.zeros((2, len(on)))
        for j, a, b in windows:
            moments[:, j] += b - a, (b - a) ** 3 / 12
        computer.log["impulse"].append(moments[0] @ true @ attitude)
        computer.log["spread"].append(moments[1] @ true @ attitude)
        computer.log["pushed"].append(moments[0] @ strength)
        edges = [edge for _, *span in windows for edge in span]
        instants = np.unique(np.round(np.array([*edges, software.since, 0.0, h]) / EXACT)) * EXACT
        for since, until in pairwise(instants.tolist()):
            instant = begin + macros.sec2nano(since)
            if 0 < since == round(software.since / EXACT) * EXACT:
                craft[0][0].UpdateState(instant)
                navigate(computer, navigators, instant)
            computer.open(windows, since, instant)
            thrusters.UpdateState(instant)
            craft[1][0].UpdateState(begin + macros.sec2nano(until))
        craft[0][0].UpdateState(begin + macros.sec2nano(h))
    states = relative(*(np.hstack([log.r_BN_N, log.v_BN_N]) for log in logs))[warm:]
    times = np.asarray(logs[0].times())[warm:] * 1e-9 - warm * h
    return Flight(times, states, **{name: np.array(log[warm:]) for name, log in computer.log.items()})


def navigate(computer: Computer, navigators: list[Any], instant: int) -> None:
    """Bring navigation up to date [ns], and let the computer ask it."""
    for navigator in navigators:
        navigator.UpdateState(instant)
    computer.measure()
