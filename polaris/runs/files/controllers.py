"""The system and its controllers as JSON: the common part of ``gains.json`` and the certificate."""

from pathlib import Path
from typing import Any

import numpy as np

from reach.networks.layers import Activation, Affine, Diagonal

from ...certificate.files.repeated import LAW
from ...certificate.model.obstacle_boxes import MOVES
from ...model.keys import python_name
from ...synthesis.controllers.black_box import BlackBox
from ...synthesis.controllers.controllers import AffineController, Controller
from ...synthesis.controllers.neural import NeuralController
from ...synthesis.safety.get_safety import Safety
from ...synthesis.safety.problem import Problem
from ...synthesis.schedule.schedule import Schedule
from .tables import errors_of, json_text, write_text

ALLOCATION = ("directions", "limits", "mixes")  # what is published of an allocation


def write_gains(path: Path, schedule: Schedule) -> None:
    """Write ``gains.json``: the law, and the certificate's system and controllers."""
    write_text(path, json_text({"law": LAW, **system_tables(schedule)}))


def system_tables(schedule: Schedule) -> dict[str, Any]:
    """Return the system, its sampling and its controllers."""
    safety, feedback = schedule.safety, schedule.safety.tracking.feedback
    return {
        "system": system_table(safety.problem),
        "sampling": {
            "step": float(safety.problem.delta),
            "steps": safety.problem.K,
            "nodes_per_step": feedback.nodes_per_cell,
        },
        "controllers": [_controller(item, safety) for item in schedule.controllers],
    }


def system_table(problem: Problem) -> dict[str, Any]:
    """Return the system and its errors."""
    system, allocation = problem.system, problem.allocation
    table = {key: getattr(allocation, key) for key in ALLOCATION if allocation is not None}
    table["layout"] = (layout := system.nozzles) is not None
    if layout is not None:
        table["kind"] = layout.allocation.kind
        table |= {"multipliers": layout.multipliers} if layout.allocation.solves else {}
    transients = [  # no pushes where navigation is lost
        {
            "name": each.name,
            "lasts": float(each.lasts),
            **({"pushes": each.pushes} if len(each.pushes) else {}),
        }
        for each in system.transients
    ]
    return {
        "kind": "linear" if system.mean_motion is None else "clohessy_wiltshire",
        "mean_motion": None if system.mean_motion is None else float(system.mean_motion),
        "mass": float(system.mass),
        "A": system.A,
        "B": system.B,
        "C": system.position,
        "D": system.D,
        "input_max": system.u_max,
        "disturbance_max": float(system.w_max),
        **({"bias_max": system.bias} if np.any(system.bias) else {}),
        "input_names": list(system.input_names),
        **errors_of(system),
        **({} if allocation is None else {"allocation": table}),
        **({"transients": transients} if transients else {}),
    }


def _controller(item: Controller, safety: Safety) -> dict[str, Any]:
    if item is safety.controller:
        return {"name": item.name, "kind": "safety", "gain": safety.controller.gain}
    if not isinstance(item, (AffineController, NeuralController)):
        return {"name": item.name, "kind": "black_box" if isinstance(item, BlackBox) else "any_thrust"}
    shared = item.own is safety.reference
    reference = {} if shared else {"reference_states": item.own.chi, "reference_inputs": item.own.nu}
    if isinstance(item, NeuralController):
        return {"name": item.name, "kind": "neural", **described(item), **reference}
    kind = "saturated_affine" if item.clips else "affine"
    return {"name": item.name, "kind": kind, "gain": item.gain, **reference}


def described(law: NeuralController) -> dict[str, Any]:
    """Return a network's inputs, layers and scales."""
    policy = law.policy
    scales = {"input_scale": policy.input_scale, "output_scale": policy.output_scale}
    moves = {key: (python_name(key), default) for key, default in MOVES.items()}
    bodies = [
        {"name": body.name, **{key: getattr(body, *arguments) for key, arguments in moves.items()}}
        for body in law.senses.bodies
    ]
    sensed = {"obstacles": bodies} if bodies else {}
    layers, precision = [layer_item(layer) for layer in policy.network.layers], policy.network.precision
    rounded = {} if precision == "real" else {"precision": precision}
    return {"inputs": list(policy.inputs), **rounded, **scales, "layers": layers, **sensed}


def layer_item(layer: Affine | Diagonal | Activation) -> dict[str, Any]:
    """One layer of a network; equal numbers of an elementwise one are kept once."""
    if isinstance(layer, Activation):
        return {"kind": layer.kind, "low": float(layer.low), "high": float(layer.high)}
    if isinstance(layer, Affine):
        return {"kind": "affine", "W": layer.W, "b": layer.b}
    parts = {"scale": layer.scale, "b": layer.b}
    return {"kind": "diagonal"} | {k: v[:1] if np.all(v == v[0]) else v for k, v in parts.items()}
