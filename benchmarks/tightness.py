"""How much of what is proven worst-case flights use up, for every source of errors alone.

    python -m benchmarks.tightness [--seeds 5000 5004 ...] [--write]

Of every unsafe set, in the period in which the proof leaves it least: the share of what is booked there
(from the undisturbed flight to the proven margin) that the closed-form worst case of that facet takes. Of
the velocity change until T: the most that its own worst case spends, over the bound. Random scenes of the
tests, commanded periodically; `--write` puts the table into docs/guarantees.md.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from polaris.model.errors import PolarisError
from polaris.scenario.scenario import load_scenario
from polaris.simulation.falsification.attacks import Attack, Attacker
from polaris.synthesis.schedule import Schedule
from polaris.synthesis.synthesize import synthesize
from tests.polaris.random_scenarios import random_scenario

SEEDS = (5000, 5004, 5008, 5012)
PLACE = Path(__file__).resolve().parents[1] / "docs" / "guarantees.md"
BEGIN, END = "<!-- tightness -->\n", "<!-- /tightness -->"
ROUNDS = 3
RUNS = 24
NOTHING = 1e-6
"""Share of a distance below which what is booked is round-off."""


def sources(scenario) -> dict[str, list[str]]:
    """Overrides with one source of errors each, in sizes of the scene's own."""
    system, problem = scenario.system(), scenario.problem()
    period, least = problem.period, float(system.u_max.min())
    half = 0.05 * scenario.initial_set().half_widths
    half = np.maximum(half, 0.05 * half.max() * (half == 0) * (system.mean_motion is None))
    if system.mean_motion is None:
        known = [f"navigation.state_error={half.tolist()}"]
    else:
        d = system.d
        known = [
            f"navigation.position_error_m={half[:d].tolist()}",
            f"navigation.velocity_error_m_s={half[d:].tolist()}",
        ]
    found = {
        "none": [],
        "navigation": known,
        "delay": [f"timing.delay_s={period!r}"],
        "missed periods": ["timing.missed_periods=2"],
        "jitter": [f"timing.jitter_s={0.002 * period!r}"],
        "magnitude": ["thrusters.magnitude_error=0.05"],
        "mass": ["thrusters.mass_error=0.03"],
        "misalignment": ["thrusters.misalignment_deg=2"],
        "bit, nearest": [f"thrusters.impulse_bit_N_s={0.02 * period * least!r}"],
        "bit, carried": [
            f"thrusters.impulse_bit_N_s={0.02 * period * least!r}",
            "thrusters.remainder=carried",
        ],
    }
    found["together"] = [
        *(x for name in ("navigation", "delay", "magnitude", "mass", "bit, nearest") for x in found[name])
    ]
    return found


def shares(schedule: Schedule, seed: int = 0) -> Iterator[float]:
    """Of every unsafe set the share that is used up in the period in which the proof leaves it least."""
    attacker = Attacker.of(schedule, False, np.random.default_rng(seed))
    claims, flight = attacker.claims, attacker.flight
    x0 = schedule.safety.problem.initial_set.c[None]
    middle = Attack(x0, np.zeros((flight.steps, 1, flight.columns[-1].stop)), None).fly(flight)
    for o, facets in enumerate(claims.facets):
        best = facets.max(axis=1)
        period = int(np.argmin(np.where(np.isfinite(best), best, np.inf)))
        facet = int(np.argmax(facets[period]))
        normal = claims.unsafe[o].normals[facet] @ flight.system.position
        used, booked = 0.0, 0.0
        for node in (period, period + 1):
            side = int(node > period)
            row = np.tile(-normal, (1, 1))
            clipped = about = None
            for _ in range(ROUNDS):
                target = np.array([max(node * flight.substeps, 1)])
                flown = attacker._towards(row, target, clipped, about).fly(flight)
                offset = claims.offsets[o][side][period, facet]
                there, undisturbed = (
                    float(runs.states[0, node] @ normal) - offset for runs in (flown, middle)
                )
                booked = undisturbed - best[period]
                used = max(used, (undisturbed - there) / max(booked, 1e-300))
                full = np.abs(flown.inputs) >= flight.system.u_max * (1 - 1e-12)
                clipped, about = np.repeat(full.swapaxes(0, 1), flight.substeps, axis=0), flown.states
        if booked > NOTHING * abs(undisturbed):
            yield used


def spent(schedule: Schedule, seed: int = 0) -> float:
    """Share of the bound on the velocity change until T that its worst case spends."""
    attacker = Attacker.of(schedule, False, np.random.default_rng(seed))
    most = float(attacker.spending(RUNS).fly(attacker.flight).delta_v.max())
    return most / schedule.delta_v[1] if schedule.delta_v[1] > 0 else 1.0


def rows(seeds: tuple[int, ...]) -> Iterator[str]:
    """Rows of the table, one per source."""
    with tempfile.TemporaryDirectory() as folder:
        scenes = []
        for seed in seeds:
            path = Path(folder) / f"{seed}.toml"
            path.write_text(random_scenario(seed), encoding="utf-8")
            scene = load_scenario(path, ["recoverable.kind=polytope"])
            if scene.problem().period is None:
                scene = scene.with_assignments([f"feedback={{kind='sampled',period_s={scene.step!r}}}"])
            scenes.append(scene)
        for name in sources(scenes[0]):
            sets, budgets = [], []
            for scene in scenes:
                try:
                    schedule = synthesize(scene.with_assignments(sources(scene)[name]))
                except PolarisError:
                    continue
                sets += list(shares(schedule))
                budgets.append(spent(schedule))
            if budgets:
                near = np.mean(np.array(sets) >= 0.75)
                yield (
                    f"| {name} | {len(budgets)} | {len(sets)} | {np.median(sets):.0%} | {near:.0%} |"
                    f" {np.median(budgets):.0%} | {min(budgets):.0%} |"
                )


def main() -> None:
    """Print the table, or write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS)
    parser.add_argument("--write", action="store_true")
    given = parser.parse_args()
    head = (
        "| Errors | scenes | sets | used up, median | sets with 75 % | velocity change, median | least |\n"
        "|---|---|---|---|---|---|---|"
    )
    lines = [head]
    print(head)
    for row in rows(tuple(given.seeds)):
        lines.append(row)
        print(row, flush=True)
    if given.write:
        before, rest = PLACE.read_text(encoding="utf-8").split(BEGIN)
        PLACE.write_text(
            before + BEGIN + "\n".join(lines) + "\n" + END + rest.split(END)[1], encoding="utf-8"
        )


if __name__ == "__main__":
    main()
