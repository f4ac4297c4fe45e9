"""Parts of the tightening at the tightest place with all errors, and what a flight takes of each.

    python -m benchmarks.error_sources [SCENE ...] [--write]

Tightening: what every channel of the loop adds along the facet by then, under the bounds on commands of each
step, without any merging of generators. Flown: by how much the worst flight of an ascent is nearer than the
same flight without that source. `--write` puts the table into docs/tightness.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from unittest.mock import patch

import numpy as np

from polaris.model.system import Array
from polaris.scenario.scenario import load_scenario
from polaris.simulation.falsification.attacks import Attack, Attacker
from polaris.synthesis.controllers.controllers import AffineController
from polaris.synthesis.schedule.schedule import Schedule
from polaris.synthesis.schedule.synthesize import synthesize

from . import tenfold
from .tightness import PLACE, Place, tightest

SCENES = ("static", "dynamic")
ROUNDS = 4
BEGIN, END = "<!-- sources -->\n", "<!-- /sources -->"
NAMES = {"start": "first errors", "disturbance": "disturbance", "estimate": "errors of estimates"}
NAMES |= {"thrusters": "errors of thrusters", "carried impulse": "carried bit", "pulses": "pulses"}


def laws_flown(schedule: Schedule, steps: int) -> list[AffineController]:
    """Return the law of each of the first steps, with the bounds on its commands that its tube rests on."""
    laws, method = list[AffineController](), AffineController._reach
    with patch.object(AffineController, "_reach", lambda law, *args: laws.append(law) or method(law, *args)):
        by_step, start = list[AffineController](), schedule.safety.tracking.loop_state(schedule.safety.start)
        for step in schedule.steps[:steps]:
            start = schedule.controllers[step.mode].propagate(start, step.k).end
            by_step.append(laws[-1])
    return by_step


def tightening_by_source(schedule: Schedule, place: Place, end: int) -> dict[str, float]:
    """Return what each channel adds along the row at an end of a place, 0 or 1 [m], without merging."""
    k, i = divmod(place.period, schedule.safety.clearance.q)
    laws = laws_flown(schedule, k + 1)
    row, by_channel = np.pad(place.row, (0, len(laws[0].closed.F) - len(place.row))), dict[str, float]()
    for number, law in reversed(list(enumerate(laws))):
        for _ in range(i + end if number == k else schedule.safety.clearance.q):
            for channel, size in law.channels():
                gains = law.closed.gains(channel, row)
                by_channel[channel.name] = by_channel.get(channel.name, 0.0) + float(np.sum(gains @ size))
            row = row @ law.closed.F
    first = schedule.safety.tracking.loop_state(schedule.safety.start)
    return by_channel | {"start": float(np.abs(row @ first.G).sum())}


def flown_by_source(attacker: Attacker, place: Place, end: int) -> tuple[float, dict[str, float]]:
    """Return how far the worst flight of an ascent goes by then, and how much less without each source."""
    flight, node, undisturbed = attacker.flight, place.nodes[end], place.undisturbed[end]
    target, previous = np.array([max(node * flight.substeps, 1)]), None

    def reached(attack: Attack) -> float:
        return float(((attack.fly(flight).states[:, node] - undisturbed) @ place.row).max())

    largest, worst = -np.inf, None
    for _ in range(ROUNDS):
        attack = attacker._towards(place.row[None], target, previous)
        previous = attack.fly(flight)
        if (distance := reached(attack)) > largest:
            largest, worst = distance, attack
    assert worst is not None
    middle = attacker.claims.schedule.safety.problem.initial_set.c[None]
    effects = {"start": largest - reached(Attack(middle, worst.w, worst.free))}
    for name, part in zip(("disturbance", "estimate", "thrusters"), flight.columns, strict=False):
        w: Array = worst.w.copy()
        w[..., part] = 0
        effects[name] = largest - reached(Attack(worst.x0, w, worst.free))
    return largest, effects


def by_source(scene: str) -> dict[str, tuple[float, float | None]]:
    """Return what each source adds, and takes in flight [m], at the place of a scene with the least left."""
    schedule = synthesize(load_scenario(scene, [*tenfold.TOGETHER["all"], *tenfold.CHEAP]))
    attacker = Attacker.from_schedule(schedule, False, np.random.default_rng(0))
    place = next(tightest(attacker))
    flights = [flown_by_source(attacker, place, end) for end in (0, 1)]
    end = int(np.argmax([reach / size for (reach, _), size in zip(flights, place.tightening, strict=True)]))
    parts, total = tightening_by_source(schedule, place, end), float(place.tightening[end])
    reach, effects = flights[end]
    sizes = {NAMES[name]: (size, effects.get(name)) for name, size in parts.items()}
    label = "merged generators, intersample bound"
    return sizes | {label: (total - sum(parts.values()), None), "all": (total, reach)}


def table(scenes: Sequence[str]) -> Iterator[str]:
    """Yield the lines of the table: a row for each source, two columns for each scene."""
    sizes = {scene: by_source(scene) for scene in scenes}
    yield f"| Source | {' | '.join(f'{scene}, tightening [m] | flown [m]' for scene in scenes)} |"
    yield "|---" * (2 * len(scenes) + 1) + "|"
    for name in dict.fromkeys(name for each in sizes.values() for name in each):
        cells = (x for each in sizes.values() for x in each.get(name, (None, None)))
        yield f"| {name} | {' | '.join('-' if x is None else f'{x:.2f}' for x in cells)} |"


def main() -> None:
    """Print the table, or write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", default=SCENES)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    lines = list(table(options.scenes))
    print(*lines, sep="\n")
    if options.write:
        before, tail = PLACE.read_text(encoding="utf-8").split(BEGIN)
        page = before + BEGIN + "\n".join(lines) + "\n" + END + tail.split(END)[1]
        PLACE.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
