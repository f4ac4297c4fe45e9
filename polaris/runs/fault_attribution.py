"""Steps that S flies because of faults that are isolated late, with the bound that is short."""

from functools import lru_cache
from typing import Any

from ..synthesis.controllers.controllers import propagate_states
from ..synthesis.safety.recoverable import Margin
from ..synthesis.schedule.schedule import Schedule


@lru_cache(maxsize=1)
def attribute_faults(schedule: Schedule) -> list[dict[str, Any]]:
    """Return, as data, the steps that each late fault keeps from experimental controllers (Proposition 8).

    Each names the controller that could fly it without late faults, and what is short with this fault alone.
    One alone is in the way; where errors of thrusters grow with commands, it is the one that leaves least.
    """
    safety, faults = schedule.safety, schedule.safety.problem.system.transients
    rows = [dict[str, Any](fault=each.name, lasts_s=each.lasts, steps=[]) for each in faults]
    starts = [safety.start, *(step.tube.end for step in schedule.steps)]
    ideal, by_fault = safety.recoverable_with(()), [safety.recoverable_with((fault,)) for fault in faults]
    for step in schedule.steps if faults else ():
        for law in schedule.controllers[1:] if step.mode == 0 else ():
            tube = propagate_states(law, starts[step.k], step.k, safety.controller)
            if tube.refused or not ideal.holds(step.k, tube.nodes, tube.intersample):
                continue
            if not safety.recoverable.holds(step.k, tube.nodes, tube.intersample):
                margins = [sets.margin(step.k, tube.nodes, tube.intersample) for sets in by_fault]
                worst = min(margin.value for margin in margins)
                for each, margin in zip(rows, margins, strict=True):
                    if not margin.inside or margin.value == worst:
                        each["steps"].append(_row(margin, step.k, safety.problem.delta, law.name))
            break
    return rows


def _row(margin: Margin, k: int, delta: float, name: str) -> dict[str, Any]:
    """Return the data of step k, which this controller would fly; steps of delta [s]."""
    at = {"limit": margin.limit, "limit_time_s": margin.time, "limit_step": int(margin.time / delta + 1e-9)}
    tightening, clearance = margin.tightening, margin.clearance
    size = {"tightening": tightening, "clearance": clearance, "shortfall": tightening - clearance}
    return {"step": k, "t_s": k * delta, "controller": name, **at, **size}
