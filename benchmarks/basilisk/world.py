"""Two spacecraft in Basilisk: gravity with J2, drag, thrusters with on-times, noisy navigation.

Equations of motion, integrator, atmosphere, drag, thrusters and the noise of navigation are Basilisk's. From
the toolkit come the scenario's numbers and the target's first state.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from Basilisk.architecture import messaging, sysModel
from Basilisk.simulation import (
    dragDynamicEffector,
    exponentialAtmosphere,
    gravityEffector,
    simpleNav,
    spacecraft,
    sphericalHarmonicsGravityModel,
    svIntegrators,
    thrusterDynamicEffector,
)
from Basilisk.utilities import RigidBodyKinematics, SimulationBaseClass, macros

from polaris.simulation.orbit.environment import EARTH_RADIUS_M, J2, MU, Environment

from .onboard import FlightSoftware

STEP = 0.05
"""Step of Basilisk's integrator [s]: the shortest pulse, and what on-times are rounded to."""

NOZZLES = 2
"""Per direction: each has its share of the thrust, and they may burn for different times."""

DRAG = 2.2
"""Drag coefficient; areas follow from the scenario's ballistic coefficients."""


@dataclass(frozen=True)
class Errors:
    """What one flight's hardware does wrong: constant over the flight, drawn within the scenario's bounds."""

    position: float = 0.0  # largest error of navigation along an axis [m]
    velocity: float = 0.0  # [m/s]
    thrust: tuple[float, ...] = (1.0,) * 6  # share of its thrust that each direction gives: +x, -x, +y, ...
    tilt: tuple[float, float, float] = (0.0, 0.0, 0.0)  # rotation vector of the thrusters' frame [rad]
    mass: float = 1.0  # true mass over that of the model


@dataclass(frozen=True)
class Flight:
    """What one flight recorded, at every control period.

    Attributes
    ----------
    times : ndarray, shape (P+1,)
    states : ndarray, shape (P+1, 6)
        True relative states in the target's frame [m, m/s].
    seen : ndarray, shape (P, 6)
        What navigation said at every control period.
    asked : ndarray, shape (P, 3)
        What the flight software asked for at every control period [N].
    burned : ndarray, shape (P, K, 3)
        True force [N] in each of the K integration steps of every control period, in that frame at its start.
    """

    times: np.ndarray
    states: np.ndarray
    seen: np.ndarray
    asked: np.ndarray
    burned: np.ndarray


def frame(r: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Hill's frame of inertial positions and velocities (..., 3): its axes as rows, its rate in them.

    Shapes (..., 3, 3) and (..., 3). J2 alone is taken to turn the orbit's plane.
    """
    h = np.cross(r, v)
    size, R = np.linalg.norm(h, axis=-1), np.linalg.norm(r, axis=-1)
    x, z = r / R[..., None], h / size[..., None]
    axes = np.stack([x, np.cross(z, x), z], axis=-2)
    across = -3 * J2 * MU * EARTH_RADIUS_M**2 / R**4 * x[..., 2] * z[..., 2]
    return axes, np.stack([R * across / size, np.zeros_like(R), size / R**2], axis=-1)


def relative(target: np.ndarray, chaser: np.ndarray) -> np.ndarray:
    """State of the chaser in the target's frame, from inertial states (..., 6)."""
    axes, rate = frame(target[..., :3], target[..., 3:])
    p = np.einsum("...ij,...j->...i", axes, chaser[..., :3] - target[..., :3])
    v = np.einsum("...ij,...j->...i", axes, chaser[..., 3:] - target[..., 3:])
    return np.concatenate([p, v - np.cross(rate, p)], axis=-1)


def absolute(target: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Inertial state of the chaser, from its state in the target's frame."""
    axes, rate = frame(target[:3], target[3:])
    return target + np.concatenate([x[:3] @ axes, (x[3:] + np.cross(rate, x[:3])) @ axes])


def inertial(env: Environment, latitude: float, target: np.ndarray) -> np.ndarray:
    """Inertial state of a target as `polaris.simulation.orbit.frame` gives it, node on the x axis."""
    R, V, h, px, py, pz = target
    inclination = np.arctan2(np.hypot(px, py), pz)
    c, s = np.cos(latitude), np.sin(latitude)
    ci, si = np.cos(inclination), np.sin(inclination)
    radial, along = np.array([c, s * ci, s * si]), np.array([-s, c * ci, c * si])
    return np.concatenate([R * radial, V * radial + h / R * along])


class Computer(sysModel.SysModel):  # type: ignore[misc]
    """Runs the flight software: navigation in, on-times of all nozzles out."""

    def __init__(self, software: FlightSoftware, navigators: list[Any], true: np.ndarray) -> None:
        super().__init__()
        self.software, self.true = software, true
        self.target, self.chaser = (messaging.NavTransMsgReader() for _ in range(2))
        self.attitude = messaging.NavAttMsgReader()
        self.target.subscribeTo(navigators[0].transOutMsg)
        self.chaser.subscribeTo(navigators[1].transOutMsg)
        self.attitude.subscribeTo(navigators[1].attOutMsg)
        self.output = messaging.THRArrayOnTimeCmdMsg()
        self.tick = 0
        self.seen: list[np.ndarray] = []
        self.asked: list[np.ndarray] = []
        self.burned: list[np.ndarray] = []
        self.queue: list[np.ndarray] = [np.zeros(3)] * software.late

    def Reset(self, _: int) -> None:
        """Nothing to prepare."""

    def UpdateState(self, now: int) -> None:
        """One control period."""
        target, chaser = (
            np.concatenate([message().r_BN_N, message().v_BN_N]) for message in (self.target, self.chaser)
        )
        x = relative(target, chaser)
        self.queue.append(self.software.command(self.tick, x))
        force = self.queue.pop(0)
        turned = (
            RigidBodyKinematics.MRP2C(np.array(self.attitude().sigma_BN)) @ frame(target[:3], target[3:])[0].T
        )
        wanted = turned @ force
        steps = round(self.software.period / STEP)
        share = np.minimum(np.abs(wanted) / self.software.limit, 1.0)
        pulses = np.round(share * steps * NOZZLES).astype(int)  # of all nozzles of a direction together
        on = np.zeros((3, 2, NOZZLES), dtype=int)
        for axis in range(3):
            on[axis, int(wanted[axis] < 0)] = [(pulses[axis] + i) // NOZZLES for i in range(NOZZLES)]
        on = on.reshape(6, NOZZLES)
        burning = (np.arange(steps)[:, None, None] < on).sum(axis=-1) / NOZZLES  # (steps, 6)
        self.seen.append(x)
        self.asked.append(force)
        self.burned.append(burning @ self.true @ turned)
        payload = messaging.THRArrayOnTimeCmdMsgPayload()
        payload.OnTimeRequest = (on.ravel() * STEP).tolist()
        self.output.write(payload, now, self.moduleID)
        self.tick += 1


def gravity() -> Any:
    """The Earth with its second zonal harmonic alone."""
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
) -> Flight:
    """One flight from the inertial states of target and chaser.

    `area` are their drag coefficients times area over mass [m^2/kg].
    """
    simulation = SimulationBaseClass.SimBaseClass()
    process = simulation.CreateNewProcess("flight")
    # At every instant: the craft arrive there, the software sees it, the nozzles hear of it.
    process.addTask(simulation.CreateNewTask("motion", macros.sec2nano(STEP)), 10)
    process.addTask(simulation.CreateNewTask("software", macros.sec2nano(software.period)), 5)
    process.addTask(simulation.CreateNewTask("nozzles", macros.sec2nano(STEP)), 1)
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
        # The midpoint rule asks for forces in the middle of steps alone: so pulses keep their impulse.
        rule = svIntegrators.svIntegratorRungeKutta(body, [[0.0, 0.0], [0.5, 0.0]], [0.0, 1.0], [0.0, 0.5])
        body.setIntegrator(rule)
        craft.append((body, drag, rule))
    thrusters = thrusterDynamicEffector.ThrusterDynamicEffector()
    turn = RigidBodyKinematics.PRV2C(np.array(errors.tilt)) if np.any(errors.tilt) else np.eye(3)
    true = np.kron(np.diag(software.limit), [[1.0], [-1.0]]) @ turn * np.array(errors.thrust)[:, None]
    for force in np.repeat(true, NOZZLES, axis=0) / NOZZLES:
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
    computer = Computer(software, navigators, true)
    thrusters.cmdsInMsg.subscribeTo(computer.output)
    for nav in navigators:
        simulation.AddModelToTask("software", nav, 20)
    simulation.AddModelToTask("software", computer, 10)
    simulation.AddModelToTask("nozzles", thrusters)
    for model in (air, *(drag for _, drag, _ in craft), *(one for one, *_ in craft)):
        simulation.AddModelToTask("motion", model)
    logs = [one.scStateOutMsg.recorder(macros.sec2nano(software.period)) for one, *_ in craft]
    for log in logs:
        simulation.AddModelToTask("motion", log)
    simulation.InitializeSimulation()
    simulation.ConfigureStopTime(macros.sec2nano(duration))
    simulation.ExecuteSimulation()
    both = [np.hstack([log.r_BN_N, log.v_BN_N]) for log in logs]
    states, periods = relative(*both), len(logs[0].times()) - 1
    times = np.asarray(logs[0].times()) * 1e-9
    seen, asked, burned = (np.array(x[:periods]) for x in (computer.seen, computer.asked, computer.burned))
    return Flight(times, states, seen, asked, burned)
