"""A run in numbers: the contents of ``summary.json``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any

import numpy as np

from ..simulation.baselines import Flown
from ..simulation.metrics import (DEFINITIONS)
from ..planning.problem import SOLVERS
from ..scenario.scenario import Scenario
from ..synthesis.schedule import Schedule
from ..model.version import versions


def summary(
    scenario: Scenario, schedule: Schedule, flown: Mapping[str, Flown], seconds: Mapping[str, float]
) -> dict[str, Any]:
    """Contents of ``summary.json``."""
    safety, found = schedule.safety, schedule.safety.plan
    stages = dict(schedule.seconds)
    return {
        "schema_version": 1,
        "scenario": scenario.name,
        "title": scenario.model.title,
        **{key: item.metrics.summary() for key, item in flown.items()},
        "synthesis": {
            "recoverable": safety.recoverable.kind,
            "experimental_share": schedule.share(),
            "switches": schedule.switches,
            "start_margin": safety.start_margin.value,
            "start_limit": safety.start_margin.limit,
            "planner": {
                "status": found.status,
                "solver": found.solver,
                "solver_name": SOLVERS[found.solver],
                "cut_by_clock": list(safety.cut_by_clock),
                "stages": [asdict(stage) for stage in found.stages],
                "gap": found.gap,
                "delta_v_m_s": found.delta_v,
                "margin_m": found.margin,
                "size": found.stats,
            },
            "seconds": {**stages, "total": sum(stages.values()), "plan_parts": found.seconds, **seconds},
        },
        "guarantee": guarantee(schedule),
        "definitions": DEFINITIONS,
        "seed": scenario.simulation.seed,
        "versions": versions(),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def guarantee(schedule: Schedule) -> dict[str, Any]:
    """What is claimed, until when, why, and on what assumptions."""
    end = schedule.safety.end
    return {
        "kind": schedule.guarantee,
        "horizon": end.horizon,
        "until_s": end.until if np.isfinite(end.until) else None,
        "reason": end.reason,
        "assumptions": list(schedule.assumptions),
    }
