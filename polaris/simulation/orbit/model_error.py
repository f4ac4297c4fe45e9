"""The model error of a scenario: how far Hill's linear equations may be off where its mission flies."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from reach.short_repr import short_repr

from ...model.errors import ScenarioError
from ...model.scene.satellite import SatelliteObstacle
from ...model.system import Array
from ...synthesis.schedule.schedule import Schedule
from ...synthesis.schedule.synthesize import synthesize
from .environment import Environment
from .frame import on_ellipse, relative_rate
from .region import Region, satellite_region, visited
from .residual import Residual, residual_bound, two_digits

MOST_ROUNDS = 8  # times a bound is raised before it is given up: it feeds back through the tubes, but weakly


@short_repr
@dataclass(frozen=True, eq=False)
class ModelError:
    """Bound on the error of the linear model over the states that a schedule visits.

    Attributes
    ----------
    scenario : Scenario
        As it was measured.
    schedule : Schedule
        Whose tubes make the region.
    region : Region
    residual : Residual
        Bounds per box of the region.
    sampled : float
        Largest residual [m/s^2] found by sampling the region and the target's orbits: at most `bound`; nan if
        nothing was sampled.
    satellites : dict
        For every satellite among the unsafe sets, until when [s] its declared acceleration covers its own
        model error; infinity if it does for as long as it is perceived.
    """

    scenario: Any
    schedule: Schedule
    region: Region
    residual: Residual
    sampled: float
    satellites: dict[str, float]

    @property
    def declared(self) -> float:
        """Return the system's disturbance bound [m/s^2]."""
        return self.schedule.safety.problem.system.w_max

    @property
    def bound(self) -> float:
        """Bound on the residual over the whole region [m/s^2]."""
        return float(self.residual.total.max())

    @property
    def covered(self) -> bool:
        """Return True if the declared bound covers it: the guarantee then holds for nonlinear motion too."""
        return self.bound <= self.declared

    @property
    def worst(self) -> int:
        """Return the box in which the bound is largest."""
        return int(np.argmax(self.residual.total))

    def summary(self) -> dict[str, Any]:
        """Return the numbers of a report; strict JSON."""
        at, sampled = self.worst, {}
        if math.isfinite(self.sampled):
            sampled = {"sampled_m_s2": self.sampled, "sampled_share": self.sampled / self.bound}
        radial, distance, speed = self.region.extent
        return {
            "scenario": self.scenario.name,
            "declared_m_s2": self.declared,
            "bound_m_s2": self.bound,
            "covered": self.covered,
            **sampled,
            "parts_m_s2": {name: float(value[at]) for name, value in self.residual.parts.items()},
            "worst": {
                "controller": self.region.names[at],
                "time_s": float(self.region.start[at]),
                "radial_m": float(radial[at]),
                "distance_m": float(distance[at]),
                "speed_m_s": float(speed[at]),
            },
            "satellites_covered_until_s": {
                name: time if math.isfinite(time) else None for name, time in self.satellites.items()
            },
        }


def model_error(scenario: Any, schedule: Schedule | None = None, samples: int = 200_000) -> ModelError:
    """Bound the model error over the states that a scenario's schedule visits.

    Parameters
    ----------
    scenario : Scenario
        With an ``[orbit]`` table.
    schedule : Schedule, optional
        Its schedule; synthesised if not given.
    samples : int
        States sampled to see how tight the bound is, or none.

    Raises
    ------
    ScenarioError
        If the scenario does not say enough.
    """
    env = Environment.from_scenario(scenario)
    schedule = synthesize(scenario) if schedule is None else schedule
    region = visited(schedule)
    residual = residual_bound(env, *region.extent)
    sampled = sample_residual(env, region, samples, np.random.default_rng(0)) if samples else math.nan
    others = {}
    safety, delta = schedule.safety, schedule.safety.problem.delta
    for satellite in (o for o in safety.problem.unsafe if isinstance(o, SatelliteObstacle)):
        box = satellite_region(satellite, safety.problem.system, delta, safety.reference.cells)
        tightening = residual_bound(replace(env, other=0.0), *box.extent).total
        short = np.flatnonzero(tightening > satellite.thrust_accel_max + safety.problem.system.w_max)
        others[satellite.name] = float(box.start[short[0]]) if len(short) else math.inf
    return ModelError(scenario, schedule, region, residual, sampled, others)


def left_out(scenario: Any, schedule: Schedule) -> dict[str, Any]:
    """Return the model error of a schedule as ``model_error`` of a summary; nothing without ``[orbit]``."""
    if scenario.model.orbit is None or schedule.safety.problem.system.mean_motion is None:
        return {}
    return {"model_error": model_error(scenario, schedule, samples=0).summary()}


def error_within(scenario: Any, distance: float) -> Residual:
    """Bound the model error within a distance [m] of the target, without a schedule.

    Relative speeds are as on the closed ellipses that reach that far, at most eta times the distance, and as
    much again for getting from one to another. The schedule that is flown may need more or less.

    Raises
    ------
    ScenarioError
        If the scenario does not say enough.
    """
    env = Environment.from_scenario(scenario)
    return residual_bound(env, distance, distance, 2 * env.mean_motion * distance)


def justify(scenario: Any) -> ModelError:
    """Raise the disturbance bound until it covers the model error of its own tubes, rounded up to two digits.

    `ScenarioError` if none is found, `SynthesisInfeasible` or `NotCertified` without a safe synthesis under
    it.
    """
    error = model_error(scenario.set("system.disturbance_max_m_s2", 0.0), samples=0)
    for _ in range(MOST_ROUNDS):
        bound = two_digits(max(error.bound, error.declared))
        error = model_error(scenario.set("system.disturbance_max_m_s2", bound))
        if error.covered:
            return error
    rule = f"has no value that covers the model error in {MOST_ROUNDS} rounds, as tubes grow with it"
    raise ScenarioError("system.disturbance_max_m_s2", error.declared, rule)


def sample_residual(env: Environment, region: Region, count: int, rng: np.random.Generator) -> float:
    """Largest residual [m/s^2] over random states, most of them corners, and random admissible targets."""
    box = rng.integers(0, len(region.start), count)
    # Half of the samples come from the boxes that the bound calls worst.
    ranked = np.argsort(-residual_bound(env, *region.extent).total)[:10]
    box[: count // 2] = rng.choice(ranked, count // 2)
    share = rng.random((count, 6))
    share[: count // 4 * 3] = np.round(share[: count // 4 * 3])
    x = region.lower[box] + share * (region.upper[box] - region.lower[box])
    target = _targets(env, count, rng)
    ballistic = env.ballistic + rng.choice([-1.0, 1.0], count) * env.ballistic_difference
    left_out = relative_rate(env, target, x, np.maximum(ballistic, 0.0))[2]
    return float(np.linalg.norm(left_out, axis=1).max() + env.other)


def _targets(env: Environment, count: int, rng: np.random.Generator) -> Array:
    """Random states of the target within declared ranges, corners among them."""
    shares = rng.uniform(-1.0, 1.0, (count, 3))
    shares[: count // 2] = np.sign(shares[: count // 2])
    e = env.eccentricity * np.where(rng.random(count) < 0.5, 1.0, rng.random(count))
    anomaly = np.where(rng.random(count) < 0.5, rng.integers(0, 4, count) / 2, 2 * rng.random(count)) * np.pi
    R, climb, turn = on_ellipse(env, e, anomaly)
    R = R + shares[:, 0] * env.radius_deviation
    turn = turn + shares[:, 2] * env.rate_deviation * env.mean_motion
    tilt = env.inclination_max * np.sqrt(rng.random(count))
    tilt[: count // 2] = env.inclination_max
    u = rng.uniform(0, 2 * np.pi, count)
    pole = np.stack([np.sin(tilt) * np.sin(u), np.sin(tilt) * np.cos(u), np.cos(tilt)], axis=-1)
    orbit = np.stack([R, climb + shares[:, 1] * env.radial_rate, R**2 * turn], axis=-1)
    return np.concatenate([orbit, pole], axis=-1)
