"""A policy trained under the shield and without it, by evolution strategies: NumPy alone, seeds fixed.

    python -m benchmarks.training [--out FILE.onnx] [--generations 120] [--scenario robot]

The task is to follow the reference of the scenario's experimental controller, which leads through obstacles.
Every episode of a vector environment flies another candidate. What is printed: return and collisions while it
learns, then of the trained policy, with the monitor between it and the plant and without.
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
from polaris.runs.training import SwitchingVectorEnv, VectorShield

WIDTH, CANDIDATES, SIGMA, RATE, DECAY = 16, 64, 0.1, 0.05, 0.005
PENALTY = 0.005
"""Taken off per period in which S flies."""


def unpacked(flat: Array, dims: list[int]) -> list[Array]:
    """Weights and biases of two tanh layers and a linear one, of candidates (R, count)."""
    shapes = [(b, a) for a, b in zip(dims, dims[1:], strict=False)] + [(d,) for d in dims[1:]]
    ends = np.cumsum([0, *(int(np.prod(shape)) for shape in shapes)])
    return [flat[:, i:j].reshape(-1, *shape) for i, j, shape in zip(ends, ends[1:], shapes, strict=False)]


def commanded(P: list[Array], seen: Array) -> Array:
    """Shares of the limits, (R, m), of R candidates that read (R, r)."""
    for i in range(3):
        seen = np.einsum("rij,rj->ri", P[i], seen) + P[3 + i]
        seen = np.tanh(seen) if i < 2 else seen
    return np.clip(seen, -1, 1)


def episodes(env: Any, P: list[Array], seed: int | None = None) -> tuple[Array, Array, Array]:
    """Returns (R,) of one episode each, whether it collided, and the share of it that S flew."""
    seen, _ = env.reset(seed=seed)
    total, alive = np.zeros(env.num_envs), np.ones(env.num_envs, dtype=bool)
    collided, steps, by_s = ~alive, np.zeros(env.num_envs), np.zeros(env.num_envs)
    while alive.any():
        seen, reward, terminated, truncated, info = env.step(commanded(P, seen))
        total, by_s, steps = total + reward * alive, by_s + info["intervened"] * alive, steps + alive
        collided = collided | (alive & terminated)
        alive = alive & ~terminated & ~truncated
    return total, collided, by_s / steps


def train(env: Any, generations: int, seed: int = 0, told: Any = None) -> tuple[Array, int]:
    """The mean of the last generation, (count,), and collisions while it learned."""
    rng = np.random.default_rng(seed)
    dims = [env.single_observation_space.shape[0], WIDTH, WIDTH, env.single_action_space.shape[0]]
    count = sum(b * a + b for a, b in zip(dims, dims[1:], strict=False))
    scale = np.concatenate([np.full(b * a, a**-0.5) for a, b in zip(dims, dims[1:], strict=False)])
    mean = np.r_[rng.normal(size=len(scale)) * scale, np.zeros(count - len(scale))]
    first, second, collisions, half = np.zeros(count), np.zeros(count), 0, env.num_envs // 2
    env.reset(seed=seed)
    for generation in range(generations):
        way = rng.normal(size=(half, count))
        tried = mean + SIGMA * np.concatenate([way, -way])
        value, collided, by_s = episodes(env, unpacked(tried, dims))
        collisions += int(collided.sum())
        rank = np.argsort(np.argsort(value)) / (len(value) - 1) - 0.5
        slope = (rank[:half] - rank[half:]) @ way / half
        first, second = 0.9 * first + 0.1 * slope, 0.99 * second + 0.01 * slope**2
        moved = (
            first / (1 - 0.9 ** (generation + 1)) / (np.sqrt(second / (1 - 0.99 ** (generation + 1))) + 1e-8)
        )
        mean = mean + RATE * 0.5 * (1 + np.cos(np.pi * generation / generations)) * (moved - DECAY * mean)
        if told and (generation % 20 == 0 or generation == generations - 1):
            found = value.mean(), by_s.mean(), collided.mean()
            told("  {:4d} return {:6.3f} S {:5.1%} collided {:5.1%}".format(generation, *found))
    return mean, collisions


def folded(env: Any, mean: Array) -> list[Array]:
    """Weights that read unscaled inputs."""
    dims = [env.single_observation_space.shape[0], WIDTH, WIDTH, env.single_action_space.shape[0]]
    P = [part[0] for part in unpacked(mean[None], dims)]
    P[0] = P[0] * env.unwrapped.flights.input_scale
    return P


def main() -> None:
    """Train both ways, fly what came of it, and write the one trained under the shield."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--scenario", default="robot")
    parser.add_argument("--generations", type=int, default=120)
    parser.add_argument("--period", type=float, default=0.25, help="of decisions while it learns [s]")
    parser.add_argument("--out", type=Path, default=FOLDER / "trained.onnx")
    asked = parser.parse_args()
    schedule = polaris.synthesize(polaris.load_scenario(asked.scenario))

    def made(shielded: bool) -> Any:
        env = SwitchingVectorEnv(schedule, CANDIDATES, period_s=asked.period)
        return VectorShield(env, PENALTY) if shielded else env

    found = {}
    for name, shielded in (("shield", True), ("none", False)):
        begun = time.perf_counter()
        mean, collisions = train(made(shielded), asked.generations, told=print)
        found[name] = mean
        print(f"trained, {name}: {collisions} collisions, {time.perf_counter() - begun:.0f} s")
    dims = [made(True).single_observation_space.shape[0], WIDTH, WIDTH, schedule.safety.problem.system.m]
    for name, mean in found.items():
        P = [np.repeat(part, CANDIDATES, axis=0) for part in unpacked(mean[None], dims)]
        for shielded in (True, False):
            value, collided, by_s = episodes(made(shielded), P, seed=1)
            print(
                f"flown, trained with {name}, {'shielded' if shielded else 'alone'}: return"
                f" {value.mean():.3f}, collided {collided.mean():.1%}, S {by_s.mean():.1%}"
            )
    write_onnx(asked.out, folded(made(True), found["shield"]))


if __name__ == "__main__":
    main()
