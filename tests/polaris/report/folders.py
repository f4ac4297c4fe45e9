"""Folders that reports are made from: one small run, and a comparison in the documented format."""

import json
from dataclasses import replace
from functools import cache

import numpy as np

from polaris.runs.schedule import write_run
from tests.polaris.tiny import flown, synthesised

EVIL = "<script>alert(1)</script>"


@cache
def fewer():
    """The tiny scene, flown three times: `compare` keeps the runs that are shown."""
    return flown()


def write_tiny(target):
    """An ordinary run folder without figures."""
    return write_run(target, *synthesised(), fewer()).path


def rewrite_json(path, change):
    """Change a JSON file in place."""
    data = json.loads(path.read_text(encoding="utf-8"))
    change(data)
    path.write_text(json.dumps(data), encoding="utf-8")


def rename(folder, title):
    """Give a run folder another title."""
    rewrite_json(folder / "summary.json", lambda data: data.update(title=title))


GUARANTEES = ("proved", "statistical", "none")


def write_comparison(target, run, flights, methods=4):
    """A comparison folder: the schedule, S alone, U alone, and more methods that fly like the schedule.

    Parameters
    ----------
    target : Path
        With ``run/`` in it already, or made here from `run`.
    run : RunFolder
    flights : mapping
        `Flights` of the run folder.
    methods : int
        How many, besides one that is not available.
    """
    sources = ["polaris", "safety", "experimental"] + ["polaris"] * (methods - 3)
    names = ["Polaris schedule", "S alone", "U alone"] + [f"filter {i}" for i in range(methods - 3)]
    keys = ["schedule", "safety", "experimental"] + [f"filter_{i}" for i in range(methods - 3)]
    arrays, rows = {}, []
    for i, (key, name, source) in enumerate(zip(keys, names, sources, strict=True)):
        item = flights[source]
        per_node = np.repeat(item.modes, (len(item.times) - 1) // len(item.modes))
        modes = np.tile(per_node, (len(item.labels), 1)) if i < 3 else np.full(item.inputs.shape[:2], -1)
        arrays |= {
            f"{key}_t_s": item.times,
            f"{key}_labels": np.array(item.labels),
            f"{key}_states": item.states + (0.02 * i if i >= 3 else 0.0),
            f"{key}_inputs": item.inputs,
            f"{key}_modes": modes,
            f"{key}_distance_m": item.nearest,
        }
        rows.append(
            {
                "key": key,
                "name": name,
                "guarantee": GUARANTEES[min(i, 2)],
                "reach": "for all time" if i == 0 else "nothing beyond these runs",
                "note": "" if i < 3 else EVIL,
                "available": True,
                "metrics": {
                    "min_distance_m": {"mean": 5.0 - i, "low": 4.5 - i, "high": 5.5 - i, "worst": 4.0 - i},
                    "min_ttc_s": None,
                    "experimental_share": {"mean": 0.1 * i, "low": 0.1 * i, "high": 0.1 * i, "worst": None},
                    "decision_p99_us": 12.5 * (i + 1),
                    "never_heard_of_m": 3.25,
                },
            }
        )
    rows.append(
        {
            "key": "gone",
            "name": "needs a licence",
            "guarantee": "none",
            "reach": "",
            "note": "not installed",
            "available": False,
            "metrics": {},
        }
    )
    np.savez(target / "comparison.npz", **arrays)
    comparison = {
        "schema_version": 1,
        "scenario": run.scenario.name,
        "title": run.scenario.model.title,
        "protocol": {
            "runs": 100,
            "seed": 0,
            "decision_period_s": 1.0,
            "latency_s": 0.0,
            "estimate_half_widths": [0.1, 0.1, 0.1],
            "initial": "corners",
            "disturbance": "worst",
            "statement": "Every method flies the same runs.",
        },
        "definitions": {"min_distance_m": "least signed distance"},
        "methods": rows,
        "paired": [
            {
                "method": key,
                "against": "schedule",
                "metric": "min_distance_m",
                "difference": -1.0,
                "low": -1.5,
                "high": -0.5,
            }
            for key in keys[1:]
        ],
    }
    (target / "comparison.json").write_text(json.dumps(comparison), encoding="utf-8")
    lines = [
        {
            "method": "filter_0",
            "t": float(t),
            "mode": int(t > 20),
            "margin": 0.5 - t / 100,
            "reason": f"{EVIL} {int(t > 20)}",
        }
        for t in range(40)
    ]
    (target / "decisions.jsonl").write_text("\n".join(map(json.dumps, lines)) + "\n", encoding="utf-8")
    return target


def without_runs(flights):
    """Return the flights with the first run alone."""
    return {key: replace(item, labels=item.labels[:1]) for key, item in flights.items()}
