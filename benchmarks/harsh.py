"""Long flights of the assured inspection filters under primaries that do their worst.

    python -m benchmarks.harsh --flights 200 --seconds 3000      the flights of docs/inspection-assured.md

States are drawn as in the paper's Monte Carlo, those that are proven from the first instant; each flight has
its own. Primaries want full thrust on every axis, at the next deputy, at the sun's cone or out of the zone;
aims and control periods go round. All constraints are looked at four times in a period, free flights after
every fourth period.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Collection, Iterator
from functools import partial
from itertools import cycle, product

import numpy as np

from polaris.inspection.backup.all_time import AllTime
from polaris.inspection.backup.brake import Brake
from polaris.inspection.backup.planner import BackupPlanner
from polaris.inspection.backup.tube import Uncertainty
from polaris.inspection.constraints.allowable_set import allowable
from polaris.inspection.constraints.families import Families
from polaris.inspection.constraints.strengthening import PRESETS
from polaris.inspection.flights.sampling import InitialConditions
from polaris.inspection.flights.simulation import SampledErrors
from polaris.inspection.inspection import Inspection
from polaris.model.thrusters import Thrusters
from polaris.rta.one_call import Decision, RunTimeFilter
from polaris.scenario.tables.filters import (
    ExplicitFilter,
    ImplicitFilter,
    SimplexExplicitFilter,
    SimplexImplicitFilter,
)

KINDS = {
    "explicit": ExplicitFilter(kind="explicit"),
    "implicit": ImplicitFilter(kind="implicit"),
    "simplex_explicit": SimplexExplicitFilter(kind="simplex_explicit"),
    "simplex_implicit": SimplexImplicitFilter(kind="simplex_implicit"),
}
AIMS = ("deputy", "cone", "far")
PERIODS = (2.0, 1.0, 2.0, 1.0, 0.2, 2.0, 1.0, 2.0, 1.0, 2.0, 1.0)
"""Fewer flights at 0.2 s, which have most decisions."""
LOOKS = 4
ERRORS = Uncertainty(0.05, 0.002, 1e-5, Thrusters.from_errors(0.01, np.deg2rad(0.25), 0.002, 0.001, 3))


class Harsh:
    """Full thrust at the next deputy, the sun's cone, out of the zone or at the chief; `mixed`: in turn."""

    def __init__(self, inspection: Inspection, aim: str, sun: float, every: float = 60.0) -> None:
        self.inspection, self.aim, self.sun, self.every = inspection, aim, sun, every

    def __call__(self, t: float, x: np.ndarray) -> np.ndarray:
        aim, p = self.aim, x[:, :3]
        if aim == "mixed":
            aim = (*AIMS, "chief")[int(t // self.every) % 4]
        angle = self.inspection.sun_angle(t, self.sun)
        cone = -np.array([np.cos(angle), np.sin(angle), 0.0]) * np.linalg.norm(p, axis=1)[:, None]
        direction = {"deputy": np.roll(p, -1, axis=0) - p, "cone": cone - p, "far": p, "chief": -p}[aim]
        return np.asarray(np.sign(direction) * self.inspection.thrust_max)


def fly(
    q: Inspection,
    period: float,
    x: np.ndarray,
    sun: float,
    seconds: float,
    decide: Callable[[float, np.ndarray], tuple[Decision, np.ndarray]],
) -> tuple[float, int, float]:
    """Least value of all constraints, periods that are not proven, share of deputies and periods on backup.

    `decide` maps the time [s] and the true states to the decision and to what acts [N].
    """
    moves = [q.discretize(period * (k + 1) / LOOKS) for k in range(LOOKS)]
    exact = Families(q, "linear", exact=True)
    free = exact.among("passive", "deputy_passive")
    least, unproven, backup, count = np.inf, 0, 0.0, round(seconds / period)
    for k in range(count):
        decision, acting = decide(k * period, x)
        unproven += decision.unproven
        backup += float(decision.on_backup.mean()) / count
        states = np.stack([x @ Phi.T + acting @ Gamma.T for Phi, Gamma in moves])
        suns = q.sun_angle(period * (k + np.arange(1, LOOKS + 1) / LOOKS), sun)
        least = min(least, *(float(v.min()) for v in allowable(q, states, suns).values()))
        if k % LOOKS == 0:
            least = min(least, float(exact(states[-1:], suns[-1:]).h[:, free].min()))
        x = states[-1]
    return least, unproven, backup


def proven(q: Inspection, brakes: Collection[Brake], seed: int) -> Iterator[tuple[np.ndarray, float]]:
    """Drawn states and suns, those that are proven from the first instant at every period."""
    drawn, k = InitialConditions(Families(q, "linear", exact=True), seed), 0
    while True:
        x, sun = (values[k] for values in drawn.first(k + 1))
        k += 1
        if all(BackupPlanner(AllTime(brake, sun)).find(0.0, x).good for brake in brakes):
            yield x, float(sun)


def fly_all(
    kind: str, flights: int, seconds: float, errors: bool = False, seed: int = 5
) -> Iterator[tuple[str, float, float, int, float]]:
    """Aim, period, and what `fly` answers, of every flight."""
    q, uncertainty = Inspection(), ERRORS if errors else Uncertainty()
    brakes = {period: Brake(q, period, uncertainty) for period in PERIODS}
    states, cases = proven(q, brakes.values(), seed), cycle(product(PERIODS, AIMS))
    for k, (x, sun), (period, aim) in zip(range(flights), states, cases, strict=False):
        f, primary = KINDS[kind].start(brakes[period], PRESETS["linear"], sun), Harsh(q, aim, sun)
        act = partial(decided, f, primary, SampledErrors(uncertainty, q, k))
        yield aim, period, *fly(q, period, x, sun, seconds, act)


def decided(
    f: RunTimeFilter, primary: Harsh, errors: SampledErrors, t: float, x: np.ndarray
) -> tuple[Decision, np.ndarray]:
    """Return a filter's answer to estimates with errors, and the force [N] that acts then."""
    estimate = errors.estimated(x)
    decision = f.filter(t, estimate, primary(t, estimate))
    return decision, errors.acting(decision.u)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--flights", type=int, default=9)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--kind", choices=KINDS, default="explicit")
    parser.add_argument("--errors", action="store_true", help="of navigation, thrusters and the model, too")
    args = parser.parse_args(arguments)
    violated = missed = 0
    for k, (aim, period, *flight) in enumerate(fly_all(args.kind, args.flights, args.seconds, args.errors)):
        least, unproven, backup = flight
        text = f"least {least:10.3g}  not proven {unproven}  on backup {backup:5.1%}"
        print(f"{k:4d} {aim:8} {period:4g} s  {text}", flush=True)
        violated, missed = violated + (least < 0), missed + unproven
    print(f"{args.flights} flights of {args.seconds:g} s: {violated} violated, {missed} periods not proven")


if __name__ == "__main__":
    main()
