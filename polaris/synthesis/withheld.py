"""Which steps S flies because of faults that are isolated late, and which bound is short by how much."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from reach.sets.zonotope import Zonotope

from .controllers import Controller, TubeSegment
from .get_safety import Safety
from .recoverable import Margin, RecoverableSet


@dataclass(frozen=True)
class Withheld:
    """What one fault keeps from experimental controllers: steps, who would fly each, and the tightest bound.

    Of each step it is told what the fault alone leaves. Without faults the step would be recoverable; with
    those declared it is not.
    """

    fault: str
    lasts: float
    steps: tuple[tuple[int, str, Margin], ...]

    def told(self, delta: float) -> dict[str, Any]:
        """As data; steps of delta [s]."""
        rows = [
            {
                "step": k,
                "t_s": k * delta,
                "controller": name,
                "limit": margin.limit,
                "limit_time_s": margin.time,
                "limit_step": int(margin.time / delta + 1e-9),
                "need": margin.need,
                "room": margin.room,
                "short": margin.need - margin.room,
            }
            for k, name, margin in self.steps
        ]
        return {"fault": self.fault, "lasts_s": self.lasts, "steps": rows}


def withheld(
    safety: Safety, controllers: Sequence[Controller], starts: Iterable[tuple[int, int, Zonotope]]
) -> tuple[Withheld, ...]:
    """What each fault that is isolated late keeps from the experimental controllers (Proposition 42).

    `starts` are steps, their modes, and the sets they start from. What all faults need is the largest of what
    they need one by one, so that one of them alone is in the way, if any; where errors of thrusters grow with
    commands more may be needed, and the fault that leaves least is named.
    """
    faults, found = safety.problem.system.transients, {}
    if not faults:
        return ()
    ideal, alone = safety.under(()), [safety.under((fault,)) for fault in faults]
    for k, mode, start in starts:
        for law in controllers[1:] if mode == 0 else ():
            tube = law.fly(start, k)
            if tube.refused or not _holds(ideal, k, tube):
                continue
            if not _holds(safety.recoverable, k, tube):
                margins = [each.margin(k, tube.nodes, tube.bow) for each in alone]
                worst = min(margin.value for margin in margins)
                found[k] = (
                    law.name,
                    [margin if not margin.inside or margin.value == worst else None for margin in margins],
                )
            break
    each = [
        tuple((k, name, margin) for k, (name, margins) in found.items() if (margin := margins[j]))
        for j in range(len(faults))
    ]
    return tuple(Withheld(f.name, f.lasts, steps) for f, steps in zip(faults, each, strict=True))


def _holds(sets: RecoverableSet, k: int, tube: TubeSegment) -> bool:
    return sets.holds(k, tube.nodes, tube.bow)
