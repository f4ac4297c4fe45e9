"""Share of the proven margins that worst-case flights use up, for every source of errors alone.

    python -m benchmarks.tightness [--seeds 5000 5004 ...] [--write]
    python -m benchmarks.tightness --sums [--write]

Of every unsafe set, in the period in which the proof leaves it least: the share of the tightening there
(from the undisturbed flight to the proven margin) that the closed-form worst case of that facet takes, and
that of the sets at the ends of the period if they kept all generators. Of the velocity change until T: the
most that its own worst case spends, over the bound. Random scenes of the tests, commanded
periodically; `--write` puts the table into docs/tightness.md. `--sums` makes the table of velocity changes
of the bundled scenes with all errors of `benchmarks.tenfold` at once.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from unittest.mock import patch

import numpy as np

from polaris.model.errors import PolarisError
from polaris.model.system import Array
from polaris.scenario.scenario import load_scenario
from polaris.simulation.falsification.attacks import Attack, Attacker
from polaris.simulation.falsification.claims import Claims
from polaris.simulation.run_metrics import Runs
from polaris.synthesis.controllers import controllers
from polaris.synthesis.schedule.schedule import Schedule
from polaris.synthesis.schedule.spending import FlightSpending, Spell
from polaris.synthesis.schedule.synthesize import synthesize
from polaris.synthesis.tracker import affine_law
from polaris.synthesis.tracker.storage import RelaxedFlight
from tests.polaris.random_scenarios import random_scenario

from . import tenfold

SEEDS = (5000, 5004, 5008, 5012)
PLACE = Path(__file__).resolve().parents[1] / "docs" / "tightness.md"
BEGIN, END = "<!-- tightness -->\n", "<!-- /tightness -->"
BEGIN_SUMS, END_SUMS = "<!-- sums -->\n", "<!-- /sums -->"
ROUNDS = 3
RUNS, ASCENTS = 24, 10
CLIMBERS, CLIMBS = 100, 8  # flights of a climb, and its rounds
NOTHING = 1e-6
"""Share of a distance below which a tightening is round-off."""


def sources(scenario) -> dict[str, list[str]]:
    """Overrides with one source of errors each, in sizes of the scene's own."""
    system, problem = scenario.system(), scenario.problem()
    period, limit = problem.period, float(system.u_max.min())
    half = 0.05 * scenario.initial_set().half_widths
    half = np.maximum(half, 0.05 * half.max() * (half == 0) * (system.mean_motion is None))
    if system.mean_motion is None:
        navigation = [f"navigation.state_error={half.tolist()}"]
    else:
        d = system.d
        navigation = [
            f"navigation.position_error_m={half[:d].tolist()}",
            f"navigation.velocity_error_m_s={half[d:].tolist()}",
        ]
    overrides = {
        "none": [],
        "navigation": navigation,
        "delay": [f"timing.delay_s={period!r}"],
        "missed periods": ["timing.missed_periods=2"],
        "jitter": [f"timing.jitter_s={0.002 * period!r}"],
        "magnitude": ["thrusters.magnitude_error=0.05"],
        "mass": ["thrusters.mass_error=0.03"],
        "misalignment": ["thrusters.misalignment_deg=2"],
        "bit, nearest": [f"thrusters.impulse_bit_N_s={0.02 * period * limit!r}"],
        "bit, carried": [
            f"thrusters.impulse_bit_N_s={0.02 * period * limit!r}",
            "thrusters.remainder=carried",
        ],
    }
    overrides["together"] = [
        *(x for name in ("navigation", "delay", "magnitude", "mass", "bit, nearest") for x in overrides[name])
    ]
    return overrides


@dataclass(frozen=True)
class Place:
    """A period, and the row of a facet; of both ends the undisturbed state, and the tightening [m]."""

    period: int
    row: Array
    undisturbed: Array
    tightening: Array

    @property
    def nodes(self) -> tuple[int, int]:
        """Return the nodes before and after the period."""
        return self.period, self.period + 1


def tightest(attacker: Attacker) -> Iterator[Place]:
    """Yield for every unsafe set the period in which the proof leaves it least, if more than round-off."""
    claims, flight = attacker.claims, attacker.flight
    x0 = claims.schedule.safety.problem.initial_set.c[None]
    middle = Attack(x0, np.zeros((flight.steps, 1, flight.columns[-1].stop)), None).fly(flight).states[0]
    for o, facets in enumerate(claims.facets):
        margins = facets.max(axis=1)
        period = int(np.argmin(np.where(np.isfinite(margins), margins, np.inf)))
        facet = int(np.argmax(facets[period]))
        row, at = -claims.unsafe[o].normals[facet] @ flight.system.position, slice(period, period + 2)
        clear = -(middle[at] @ row) - [part[period, facet] for part in claims.offsets[o]]
        tightening = clear - margins[period]
        if tightening.max() > NOTHING * np.abs(clear).max():
            yield Place(period, row, middle[at], tightening)


def worst(attacker: Attacker, place: Place) -> float:
    """Return the largest share of the tightening at a place that flights take."""
    flight, used = attacker.flight, 0.0
    for node, undisturbed, tightening in zip(place.nodes, place.undisturbed, place.tightening, strict=True):
        previous, target = None, np.array([max(node * flight.substeps, 1)])
        for _ in range(ROUNDS):
            attack = attacker._towards(place.row[None], target, previous)
            runs = previous = attack.fly(flight)
            deviation = (runs.states[:, node] - undisturbed) @ place.row
            used = max(used, float(deviation.max()) / max(tightening, 1e-300))
    return used


def with_all_generators(schedule: Schedule) -> Claims:
    """Return the claims as if the sets of the same schedule kept all of their generators."""
    steps, start, safety = [], schedule.steps[0].tube.nodes[0], schedule.safety
    laws = [law.with_reference(safety.reference, safety.tracking) for law in schedule.controllers]
    with patch.multiple(controllers, ORDER=1e9, WIDE=1e9, WHOLE=1e9), patch.object(affine_law, "ORDER", 1e9):
        for step in schedule.steps:
            steps.append(replace(step, tube=laws[step.mode].propagate(start, step.k)))
            start = steps[-1].tube.end
    return Claims(replace(schedule, steps=steps), False)


def parts(schedule: Schedule) -> Iterator[tuple[float, float]]:
    """Yield for every set its shares of the tightening: flown, and needed by sets with all generators."""
    attacker = Attacker.from_schedule(schedule, False, np.random.default_rng(0))
    claims, full_claims = attacker.claims, with_all_generators(schedule)
    for place in tightest(attacker):
        k, at = divmod(place.period, claims.q)
        nominal = schedule.safety.reference.fine(claims.q)[k, at : at + 2]
        deviation = (place.undisturbed - nominal) @ place.row
        tightening = full_claims._tightenings(place.row[None])[0][k, at : at + 2, 0] - deviation
        yield worst(attacker, place), float(np.max(tightening / place.tightening))


def spent(schedule: Schedule, seed: int = 0) -> float:
    """Share of the bound on the velocity change until T that its worst case spends."""
    attacker = Attacker.from_schedule(schedule, False, np.random.default_rng(seed))
    largest = float(attacker.spending(RUNS).fly(attacker.flight).delta_v.max())
    return largest / schedule.delta_v[1] if schedule.delta_v[1] > 0 else 1.0


@dataclass(frozen=True)
class Sums:
    """Velocity changes of a schedule [m/s]: proven, and the most that worst cases of them spend."""

    until_goal: tuple[float, float]
    per_orbit: tuple[float, float]  # once S has settled

    @classmethod
    def of(cls, schedule: Schedule, seed: int = 0) -> Sums:
        """Fly worst cases until the end of the coasting tail; the goal is reached and S keeps to it."""
        system, arrival, upkeep = schedule.safety.problem.system, schedule.arrival, schedule.upkeep
        assert arrival.by is not None and upkeep is not None and upkeep.per_orbit is not None
        attacker, h = (
            Attacker.from_schedule(schedule, True, np.random.default_rng(seed)),
            schedule.safety.tracking.flow.h,
        )
        goal, settled = round(arrival.by / h) - 1, round(upkeep.settled / h) - 1

        def spent(runs: Runs) -> Array:
            """Return the velocity change of flights after each period [m/s], shape (R, K)."""
            return np.asarray(np.cumsum(np.abs(runs.inputs) @ system.weights, axis=1) * h / system.mass)

        first, later = (
            spent(attacker.spending(2 * RUNS, ASCENTS, until).fly(attacker.flight))
            for until in (goal + 1, None)
        )
        first = np.append(first[:, goal], climb(attacker, goal + 1, lambda runs: spent(runs)[:, goal]))
        rate = (later[:, -1] - later[:, settled]) / ((later.shape[1] - 1 - settled) * h)
        orbit = upkeep.per_orbit / upkeep.rate
        return cls((arrival.delta_v, float(first.max())), (upkeep.per_orbit, orbit * float(rate.max())))

    @property
    def ratios(self) -> tuple[float, float]:
        """Return the ratios of proven to flown velocity change, until the goal and per orbit."""
        return self.until_goal[0] / self.until_goal[1], self.per_orbit[0] / self.per_orbit[1]


def climb(attacker: Attacker, periods: int, delta_v_of: Callable[[Runs], Array]) -> float:
    """Return the largest velocity change of flights that follow projections of the relaxed flight [m/s].

    The relaxed flight is the one by which the bound is found. A flight follows one of its projections where
    disturbances are the worst for the signs of those commands (M. X. Goemans and D. P. Williamson, J. ACM 42,
    1995, round relaxed cuts so). The best directions stay, and others are drawn nearer to them each round.
    """
    flight, schedule, rng = attacker.flight, attacker.claims.schedule, np.random.default_rng(0)
    spells = [Spell.from_tube(schedule.controllers[step.mode], step.tube, step.k) for step in schedule.steps]
    spells += schedule.tail.steps_until(max(periods - len(spells) * schedule.safety.clearance.q, 0))
    steps = FlightSpending(spells, periods)._steps(range(len(spells)), periods)
    relaxed, m = RelaxedFlight(steps, spells[0].start), flight.system.m
    relaxed.ascend()
    commands = np.array([u[:m] for u in relaxed.commands()])
    directions, size, top = rng.normal(size=(CLIMBERS, commands.shape[2])), 0.6, 0.0
    for _ in range(CLIMBS):
        signs = np.zeros((flight.steps, CLIMBERS, m))
        along = np.repeat(np.sign(np.einsum("kmv,rv->krm", commands, directions)), flight.substeps, axis=0)
        signs[: len(along)] = along
        runs, rows = None, np.zeros((CLIMBERS, flight.system.n))
        for _ in range(2):  # errors of thrusters are those of the commands just flown
            runs = attacker._towards(rows, np.full(CLIMBERS, flight.steps), runs, signs).fly(flight)
        assert runs is not None
        delta_v = delta_v_of(runs)
        leaders, top = np.argsort(-delta_v)[:10], max(top, float(delta_v.max()))
        trials = directions[rng.choice(leaders, CLIMBERS - len(leaders))]
        trials /= np.linalg.norm(trials, axis=1, keepdims=True)
        directions = np.concatenate([directions[leaders], trials + size * rng.normal(size=trials.shape)])
        size *= 0.7
    return top


def sums(scene: str) -> Sums:
    """Return the sums of a bundled scene with all errors at once."""
    return Sums.of(synthesize(load_scenario(scene, [*tenfold.TOGETHER["all"], *tenfold.CHEAP])))


def sum_rows(scenes: tuple[str, ...] = tenfold.SCENES) -> Iterator[str]:
    """Rows of the table of velocity changes, one per scene."""
    for scene in scenes:
        one = sums(scene)
        yield f"| {scene} | {' | '.join(f'{x:.2f}' for x in (*one.until_goal, *one.per_orbit))} |"


def rows(seeds: tuple[int, ...]) -> Iterator[str]:
    """Rows of the table, one per source."""
    with tempfile.TemporaryDirectory() as folder:
        scenes = []
        for seed in seeds:
            path = Path(folder) / f"{seed}.toml"
            path.write_text(random_scenario(seed), encoding="utf-8")
            scene = load_scenario(path, ["recoverable.kind=polytope"])
            if scene.problem().period is None:
                scene = scene.with_assignments([f"feedback={{period_s={scene.step!r}}}"])
            scenes.append(scene)
        for name in sources(scenes[0]):
            sets, budgets = [], []
            for scene in scenes:
                try:
                    schedule = synthesize(scene.with_assignments(sources(scene)[name]))
                except PolarisError:
                    continue
                sets += list(parts(schedule))
                budgets.append(spent(schedule))
            if budgets:
                used, full = np.median(sets, axis=0)
                tight = np.mean(np.array(sets)[:, 0] >= 0.75)
                shares = used, tight, full, np.median(budgets), min(budgets)
                yield f"| {name} | {' | '.join(f'{x:.0%}' for x in shares)} |"


def main() -> None:
    """Print a table, or write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS)
    parser.add_argument("--sums", action="store_true")
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    heads = (
        "| Errors | used up, median | sets with 75 % | all generators | delta-v, median | least |",
        "| Scene | until the goal, proven | flown | per orbit, proven | flown |",
    )
    head = heads[options.sums]
    lines = [head, "|---" * (head.count("|") - 1) + "|"]
    print(*lines, sep="\n")
    for row in sum_rows() if options.sums else rows(tuple(options.seeds)):
        lines.append(row)
        print(row, flush=True)
    if options.write:
        begin, end = (BEGIN_SUMS, END_SUMS) if options.sums else (BEGIN, END)
        before, tail = PLACE.read_text(encoding="utf-8").split(begin)
        page = before + begin + "\n".join(lines) + "\n" + end + tail.split(end)[1]
        PLACE.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
