"""Attacks on the run folder of a mission: on every leg, and on every joint."""

from typing import Any

import numpy as np

from ...simulation.falsification.search import falsify
from ...simulation.mission import attack, used_share
from ..files.folder import RunFolder
from ..read_schedule import read_schedule


def falsify_mission(folder: RunFolder, runs: int, seed: int) -> dict[str, Any]:
    """Search for flights that break claims of the legs of a run folder, and for states that miss a joint.

    Every leg has its share of the runs. A joint is attacked at the ends of the spans in which GO is given,
    from the corners of the leg's own start set, along every coordinate.
    """
    picture, legs = folder.plot_data(), list[dict[str, Any]]()
    rng, joints = np.random.default_rng(seed), picture.certificate["joints"]
    for i, leg in enumerate(picture.legs):
        schedule, share, count = read_schedule(leg), None, 0
        search = falsify(schedule, max(runs // len(picture.legs), 1), seed)
        if i < len(joints):
            q, n = schedule.safety.clearance.q, schedule.safety.problem.system.n
            nodes = sorted({node for span in joints[i]["first"] for node in span})
            box = folder.scenario.model.legs[i + 1].initial_set
            start = np.array(box.center), np.diag(box.half_widths)
            ends = [len(schedule.steps) * q + node for node in nodes]
            flights = [attack(schedule, end, 2 * n, rng) for end in ends]
            used = [used_share(x.states[:, end], *start) for x, end in zip(flights, ends, strict=True)]
            share, count = max(used, default=0.0), 2 * n * len(ends)
        failure = None if search.failure is None else str(search.failure)
        row = {"name": folder.scenario.model.legs[i].name, "runs": search.runs, "failure": failure}
        legs.append(row | {"attacks": count, "share_of_start_set": share})
    missed = any((leg["share_of_start_set"] or 0.0) > 1 for leg in legs)
    return {"legs": legs, "violated": missed or any(leg["failure"] for leg in legs)}
