"""Folders that reports are made from: one small run, and a comparison in the documented format."""

import json

import numpy as np

from polaris.runs.schedule import write_run
from tests.polaris.tiny import flown, synthesised

EVIL = "<script>alert(1)</script>"


def write_tiny(target):
    """An ordinary run folder without figures."""
    return write_run(target, *synthesised(), flown()).path


def rewrite_json(path, change):
    """Change a JSON file in place."""
    data = json.loads(path.read_text(encoding="utf-8"))
    change(data)
    path.write_text(json.dumps(data), encoding="utf-8")


def rename(folder, title):
    """Give a run folder another title."""
    rewrite_json(folder / "summary.json", lambda data: data.update(title=title))


def write_comparison(target, run, flights):
    """Add a comparison to `target`: the run's schedule, S alone, U alone, a filter, a method left out."""
    methods = {
        "schedule": ("Polaris schedule", "polaris", "proved", "for all time"),
        "safety": ("S alone", "safety", "statistical", "nothing beyond these runs"),
        "experimental": ("U alone", "experimental", "none", "nothing beyond these runs"),
        "filter_0": ("filter 0", "polaris", "none", "nothing beyond these runs"),
    }
    arrays, rows = {}, []
    for i, (key, (name, source, guarantee, reach)) in enumerate(methods.items()):
        item = flights[source]
        per_node = np.repeat(item.modes, (len(item.times) - 1) // len(item.modes))
        arrays |= {
            f"{key}_t_s": item.times,
            f"{key}_labels": np.array(item.labels),
            f"{key}_states": item.states + (0.02 * i if i >= 3 else 0.0),
            f"{key}_inputs": item.inputs,
            f"{key}_modes": np.tile(per_node, (len(item.labels), 1))
            if i < 3
            else np.full(item.inputs.shape[:2], -1),
            f"{key}_distance_m": item.nearest,
        }
        metrics = {
            "min_distance_m": {"mean": 5.0 - i, "low": 4.5 - i, "high": 5.5 - i, "worst": 4.0 - i},
            "min_ttc_s": None,
            "experimental_share": {"mean": 0.1 * i, "low": 0.1 * i, "high": 0.1 * i, "worst": None},
            "decision_p99_us": 12.5 * (i + 1),
            "never_heard_of_m": 3.25,
        }
        row = {"key": key, "name": name, "guarantee": guarantee, "reach": reach}
        row["note"] = "" if i < 3 else EVIL
        rows.append(row | {"available": True, "metrics": metrics})
    missing = {"key": "gone", "name": "needs a licence", "guarantee": "none", "reach": ""}
    missing |= {"note": "not installed"}
    rows.append(missing | {"available": False, "metrics": {}})
    np.savez(target / "comparison.npz", **arrays)
    pair = {"against": "schedule", "metric": "min_distance_m", "difference": -1.0, "low": -1.5, "high": -0.5}
    protocol = {"runs": 100, "seed": 0, "decision_period_s": 1.0, "latency_s": 0.0, "initial": "corners"}
    protocol |= {"estimate_half_widths": [0.1, 0.1, 0.1], "disturbance": "worst"}
    comparison = {
        "schema_version": 1,
        "scenario": run.scenario.name,
        "title": run.scenario.model.title,
        "protocol": protocol | {"statement": "Every method flies the same runs."},
        "definitions": {"min_distance_m": "least signed distance"},
        "methods": rows,
        "paired": [{"method": key, **pair} for key in [*methods][1:]],
    }
    (target / "comparison.json").write_text(json.dumps(comparison), encoding="utf-8")
    log = [
        {"method": "filter_0", "t": float(t), "mode": int(t > 20), "margin": 0.5 - t / 100} for t in range(40)
    ]
    log = [row | {"reason": f"{EVIL} {row['mode']}"} for row in log]
    (target / "decisions.jsonl").write_text("\n".join(map(json.dumps, log)) + "\n", encoding="utf-8")
    return target
