"""Violations of a schedule's claims: which, when, by how much, and confirmation by another flight."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...synthesis.safety.recoverable import directed
from ..delayed import flies
from ..on_board import FlightCode
from ..run_metrics import Runs
from .attacks import Attack
from .claims import EXACT_INPUT, EXACT_M, Attained, Claims, attained

KINDS = ("unsafe set", "saturation", "margin")
"""Kinds of violation while it is flown, the gravest first; then those of drift, abort and velocity change."""


@dataclass(frozen=True)
class Failure:
    """One violation.

    Attributes
    ----------
    kind : {"unsafe set", "saturation", "margin", "drift", "abort", "velocity change"}
        A timed polytope was entered; S asked for more thrust than there is; a run came closer than proven; so
        did the drift of one in which all thrust stopped; an aborted one missed its orbit, or spent more; one
        spent more until T.
    limit : str
        Which unsafe set or input.
    time_s : float
        When [s].
    margin : float
        Margin there [m or N]; below zero for the first two kinds.
    proven : float
        What was proven for that period (-inf: nothing).
    """

    kind: str
    limit: str
    time_s: float
    margin: float
    proven: float

    @property
    def broken(self) -> bool:
        """Return True if a claim is broken: margins are below proven ones, but for rounding."""
        if self.kind == "velocity change":
            return self.margin < -EXACT_INPUT * self.proven
        return self.kind in KINDS or self.margin < self.proven - EXACT_M

    def __str__(self) -> str:
        claimed = (
            f"{directed(self.proven, '.4g')} is proven" if np.isfinite(self.proven) else "nothing is proven"
        )
        event = {
            "unsafe set": f"{self.limit} is entered",
            "saturation": f"S demands more {self.limit} than the limit",
            "margin": f"the margin to {self.limit} is below the proven one",
            "velocity change": f"the delta-v exceeds {self.limit}",
            "abort": f"an aborted flight exceeds its {self.limit}",
            "drift": f"the drift after all thrust stops comes closer to {self.limit} than proven",
        }[self.kind]
        return f"{event} at t = {self.time_s:.6g} s (margin {self.margin:.4g}, {claimed})"


Found = tuple[Failure, tuple[Attack, bool]]
"""A violation and its case."""


def broken(claims: Claims, measured: Attained) -> tuple[Any, Any, Any]:
    """Return the limits that each run violates: entered, asked for too much, closer than proven."""
    obstacles = len(claims.unsafe)
    exact = np.full(len(claims.names), EXACT_M)
    exact[obstacles:] = EXACT_INPUT * claims.system.u_max
    entered, beyond = measured.margin < 0, measured.margin < -exact
    entered[:, obstacles:] = beyond[:, :obstacles] = False
    return entered, beyond, measured.below > exact


def violation(claims: Claims, measured: Attained, run: int = 0) -> Failure | None:
    """Return the gravest violation of one run; None if it has none."""
    sizes = measured.margin[run], measured.margin[run], -measured.below[run]
    for kind, mask, size in zip(KINDS, broken(claims, measured), sizes, strict=True):
        which = np.flatnonzero(mask[run])
        if len(which):
            limit = int(which[np.argmin(size[which])])
            time_s, margin = float(measured.when[run, limit]), float(measured.margin[run, limit])
            floor = float(claims.floor[claims.period_at(time_s), limit])
            return Failure(kind, claims.names[limit], time_s, margin, floor)
    return None


def overspent(runs: Runs) -> tuple[Failure, int]:
    """Return the failure of the run that spends most until T, against any claim of that; and the run."""
    schedule, run = runs.schedule, int(np.argmax(runs.delta_v))
    bound = schedule.delta_v[1] if schedule.guarantee == "proved" else np.inf
    margin = bound - float(runs.delta_v[run])
    return Failure("velocity change", "the bound until T", float(schedule.times[-1]), margin, bound), run


def confirm(claims: Claims, attack: Attack, code: FlightCode | None = None) -> Failure | None:
    """Fly one attack again, alone; return its violation, or None if there is none."""
    flight = flies(claims.system)(claims.schedule, claims.modes, 1)
    flight.code = code
    return violation(claims, attained(claims, attack.fly(flight), attack.faults))
