"""A policy trained under the shield and without it, by evolution strategies: NumPy alone, seeds fixed.

    python -m benchmarks.training --out trained.onnx
    python -m benchmarks.training --speed

The task is to follow the reference of the scenario's experimental controller, which leads through obstacles.
Every episode of a vector environment flies another candidate. Printed are the collisions while it learns,
then what the trained policies come to with the monitor between them and the plant, and without it.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

import polaris
from benchmarks.policies import FOLDER, write_onnx
from polaris.model.system import Array
from polaris.runs.training import (
    InspectionEnv,
    InspectionVectorEnv,
    Shield,
    SwitchingEnv,
    SwitchingVectorEnv,
    VectorShield,
)

WIDTH, CANDIDATES, SIGMA, RATE, DECAY = 16, 64, 0.1, 0.05, 0.005
PENALTY = 0.005
"""Taken off per period in which S flies."""
HOW = {True: "shield", False: "none"}
NAMES = {"shield": "under the shield", "none": "alone"}


def unpacked(flat: Array, dims: list[int]) -> list[Array]:
    """Weights and biases of two tanh layers and a linear one, of candidates (R, count)."""
    shapes = [(b, a) for a, b in zip(dims, dims[1:], strict=False)] + [(d,) for d in dims[1:]]
    ends = np.cumsum([0, *(int(np.prod(shape)) for shape in shapes)])
    return [flat[:, i:j].reshape(-1, *shape) for i, j, shape in zip(ends, ends[1:], shapes, strict=False)]


def commanded(P: list[Array], values: Array) -> Array:
    """Shares of the limits, (R, m), of R candidates that read (R, r)."""
    for i in range(3):
        values = np.einsum("rij,rj->ri", P[i], values) + P[3 + i]
        values = np.tanh(values) if i < 2 else values
    return np.clip(values, -1, 1)


def episodes(env: Any, P: list[Array], seed: int | None = None) -> tuple[Array, Array, Array]:
    """Returns (R,) of one episode each, whether it collided, and the share of it that S flew."""
    observation, _ = env.reset(seed=seed)
    total, alive = np.zeros(env.num_envs), np.ones(env.num_envs, dtype=bool)
    collided, steps, by_s = ~alive, np.zeros(env.num_envs), np.zeros(env.num_envs)
    while alive.any():
        observation, reward, terminated, truncated, info = env.step(commanded(P, observation))
        total, by_s, steps = total + reward * alive, by_s + info["intervened"] * alive, steps + alive
        collided = collided | (alive & terminated)
        alive = alive & ~terminated & ~truncated
    return total, collided, by_s / steps


def train(env: Any, generations: int, seed: int = 0) -> tuple[Array, int]:
    """Return the mean of the last generation, (count,), and collisions while it learned."""
    rng = np.random.default_rng(seed)
    dims = [env.single_observation_space.shape[0], WIDTH, WIDTH, env.single_action_space.shape[0]]
    count = sum(b * a + b for a, b in zip(dims, dims[1:], strict=False))
    scale = np.concatenate([np.full(b * a, a**-0.5) for a, b in zip(dims, dims[1:], strict=False)])
    mean = np.r_[rng.normal(size=len(scale)) * scale, np.zeros(count - len(scale))]
    first, second, collisions, half = np.zeros(count), np.zeros(count), 0, env.num_envs // 2
    env.reset(seed=seed)
    for generation in range(generations):
        directions = rng.normal(size=(half, count))
        tried = mean + SIGMA * np.concatenate([directions, -directions])
        value, collided, by_s = episodes(env, unpacked(tried, dims))
        collisions += int(collided.sum())
        rank = np.argsort(np.argsort(value)) / (len(value) - 1) - 0.5
        slope = (rank[:half] - rank[half:]) @ directions / half
        first, second = 0.9 * first + 0.1 * slope, 0.99 * second + 0.01 * slope**2
        update = (
            first / (1 - 0.9 ** (generation + 1)) / (np.sqrt(second / (1 - 0.99 ** (generation + 1))) + 1e-8)
        )
        mean = mean + RATE * 0.5 * (1 + np.cos(np.pi * generation / generations)) * (update - DECAY * mean)
    return mean, collisions


def folded(env: Any, mean: Array) -> list[Array]:
    """Weights that read unscaled inputs."""
    dims = [env.single_observation_space.shape[0], WIDTH, WIDTH, env.single_action_space.shape[0]]
    P = [part[0] for part in unpacked(mean[None], dims)]
    P[0] = P[0] * env.unwrapped.flights.scale
    return P


def speed(env: Any, steps: int = 150) -> float:
    """Periods per second under random full thrust, resets included, of one core."""
    rng, count = np.random.default_rng(0), 0
    env.reset(seed=0)
    env.step(np.zeros(env.action_space.shape, dtype=np.float32))
    start = time.process_time()
    for _ in range(steps):
        *_, failed, ended, _ = env.step(rng.choice([-1.0, 1.0], env.action_space.shape).astype(np.float32))
        count += np.size(failed)
        if np.size(failed) == 1 and (failed or ended):
            env.reset()
    return count / max(time.process_time() - start, 1e-3)  # clocks of processes may be coarse


def report(schedule: Any, make_env: Any, policies: dict[str, Array]) -> None:
    """Fly what was trained, with the shield and without it, and S alone."""
    dims = [make_env(True).single_observation_space.shape[0], WIDTH, WIDTH, schedule.safety.problem.system.m]
    for name, mean in [*policies.items(), ("S alone", np.full_like(policies["shield"], np.nan))]:
        P = [np.repeat(part, CANDIDATES, axis=0) for part in unpacked(mean[None], dims)]
        for shielded in (True, False)[: 1 if name == "S alone" else 2]:
            value, collided, by_s = episodes(make_env(shielded, 0.0), P, seed=1)
            text = name if name == "S alone" else f"trained {NAMES[name]}, flown {NAMES[HOW[shielded]]}"
            print(
                f"{text:48} return {value.mean():6.2f}  collided {collided.mean():4.0%}  S {by_s.mean():4.0%}"
            )


def main() -> None:
    """Train both ways, fly what came of it, and write the policy trained under the shield."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--scenario", default="robot")
    parser.add_argument("--generations", type=int, default=100)
    parser.add_argument("--period", type=float, default=0.25, help="of decisions while it learns [s]")
    parser.add_argument("--out", type=Path, default=FOLDER / "trained.onnx")
    parser.add_argument("--speed", action="store_true", help="periods per second, and nothing else")
    options = parser.parse_args()
    schedule = polaris.synthesize(polaris.load_scenario(options.scenario))

    def made(shielded: bool, penalty: float = PENALTY) -> Any:
        env = SwitchingVectorEnv(schedule, CANDIDATES, period_s=options.period)
        return VectorShield(env, penalty) if shielded else env

    def inspections() -> Any:
        return InspectionVectorEnv("inspection", CANDIDATES)

    if options.speed:
        for name, env in (
            (f"{CANDIDATES} episodes", made(False)),
            (f"{CANDIDATES} episodes, shielded", made(True)),
            ("1 episode, shielded", Shield(SwitchingEnv(schedule, period_s=options.period))),
            ("inspection, 5 deputies, shielded", Shield(InspectionEnv("inspection"))),
            (f"{CANDIDATES} inspections", inspections()),
            (f"{CANDIDATES} inspections, shielded", VectorShield(inspections())),
            (f"{CANDIDATES} inspections, barriers", VectorShield(inspections(), proven=False)),
        ):
            print(f"{name:36} {speed(env):8.0f} periods/s")
        return
    policies = {}
    for name, shielded in (("shield", True), ("none", False)):
        policies[name], collisions = train(made(shielded), options.generations)
        count = options.generations * CANDIDATES
        print(f"training {NAMES[name]}: {collisions} collisions in {count} episodes")
    report(schedule, made, policies)
    write_onnx(options.out, folded(made(True), policies["shield"]))


if __name__ == "__main__":
    main()
