"""The certificate against the scenario beside it: the system and the scene that were asked for."""

import math
from itertools import groupby
from typing import Any

from flint import arb, arb_mat

from ..kernel.balls import largest, matrix, require, row_sums
from ..kernel.verdict import Record, Rejected
from ..kernel.zonotopes import inner_radius
from ..model.allocation import Nozzles, check_allocation, per_axis
from ..model.lqr import check_gain, positive_definite
from ..model.navigation import measured_errors
from ..model.obstacle_boxes import bodies_of
from ..model.perception import check_unsafe
from ..model.references import check_goal, check_references
from ..model.timing import check_timing
from ..model.transients import check_transients
from .document import ROUNDED, Document
from .repeated import switches, switching_rules

HILL_RANGE = 1e5  # farthest start from the target in Hill's frame [m]

MOST_GENERATORS = 200  # most generators of the zonotope around a ball: every two of them span a facet


def check_inputs(document: Document, scenario: dict[str, Any], record: Record) -> None:
    """Compare the certificate with the scenario of the run folder, whose keys and types are known."""
    try:
        if scenario["name"] != document.scenario:
            raise Rejected("system", f"{document.scenario} is not the scenario {scenario['name']}")
        _check_system(document, scenario["system"])
        check_allocation(document, scenario)
        _check_thrusters(document, scenario)
        check_timing(document, scenario, measured_errors(document, scenario))
        check_transients(document, scenario)
        record.holds("system", "matrices, limits and estimate errors are the scenario's")
        _check_initial_set(document, scenario["initial_set"])
        record.holds("initial_set", f"contains the scenario's {scenario['initial_set']['kind']}")
        _check_sampling(document, scenario)
        record.holds("sampling", "steps are the scenario's, and its control period if given")
        count = check_unsafe(document, scenario)
        moving = [spec["name"] for spec in scenario.get("obstacles", ()) if _moves(spec)]
        branches = [] if document.powered is None else document.powered.branches
        if moving and "infinite" in (document.horizon, *(branch.horizon for branch in branches)):
            raise Rejected("end", f"safe for all time is claimed, but unsafe sets move: {', '.join(moving)}")
        _check_abort(document, scenario.get("abort"))
        _check_orbit(document, scenario.get("abort", {}))
        record.holds("unsafe_sets", f"{count} timed polytopes contain the scenario's sets at all times")
        _check_controllers(document, scenario)
        text = "gains follow from their weights and stabilise, references are the scenario's"
        record.holds("controllers", f"{len(document.laws) - 1} experimental, {text}")
        record.holds("schedule", _check_switching(document, scenario))
        kind = scenario.get("recoverable", {}).get("kind", "polytope")
        _tightening("recoverable_sets", "kind", document.recoverable, kind)
        check_goal(scenario["goal"], document, document.states[document.steps], "goal", "the reference")
        record.holds("goal", f"the reference ends in the scenario's {scenario['goal']['kind']}")
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, ZeroDivisionError) as error:
        text = f"scenario.toml cannot be compared: {type(error).__name__}: {error}"
        raise Rejected("artefacts", text) from error


def _check_abort(document: Document, spec: dict[str, Any] | None) -> None:
    """Check that the claim of the drift after all thrust stops meets the scenario's demand."""
    drift = document.drift
    has_drift = spec is not None and bool({"drift_s", "drift_orbits"} & set(spec))
    if has_drift != (drift is not None):
        raise Rejected("passive", "only one of certificate and scenario has a drift")
    if spec is None or drift is None:
        return
    if "drift_s" in spec and "drift_orbits" in spec:
        raise Rejected("passive", "the scenario must give one of drift_orbits and drift_s")
    duration = (
        arb(spec["drift_s"])
        if "drift_s" in spec
        else (spec["drift_orbits"] * 2 * arb.pi() / arb(document.mean_motion or 0.0))
    )
    require("passive", drift.horizon - duration * (1 - ROUNDED), f"{drift.horizon:.6g} s are too short")
    if not drift.keep_in and spec.get("keep_in", True):
        raise Rejected("passive", "keep-in sets are required by the scenario, but not covered")
    if None in drift.steps and spec.get("required", False):
        raise Rejected("passive", f"step {drift.steps.index(None)} is not clear, but all steps are required")


def _check_orbit(document: Document, spec: dict[str, Any]) -> None:
    """Check that claims of aborts with thrust are those that the scenario asks for."""
    powered = document.powered
    if ("orbit" in spec) != (powered is not None):
        raise Rejected("powered_abort", "only one of certificate and scenario has a powered abort")
    if powered is None:
        drift, limits = {"drift_s", "drift_orbits"} & set(spec), {"within_s", "delta_v_max_m_s"} & set(spec)
        if spec and (limits or not drift):
            raise Rejected("powered_abort", "the scenario has [abort] without an orbit or a drift")
        return
    demands = spec.get("within_s"), spec.get("delta_v_max_m_s")
    if (powered.within, powered.budget) != demands:
        raise Rejected("powered_abort", "time and budget are not those of the scenario")
    if None in powered.steps and spec.get("required", False):
        raise Rejected("powered_abort", f"step {powered.steps.index(None)} has none, but all must")


def _moves(spec: dict[str, Any]) -> bool:
    """Return True if an obstacle moves, however slowly."""
    return spec["kind"] == "satellite" or any(spec.get("velocity_m_s") or ())


def _tightening(claim: str, quantity: str, claimed: Any, expected: Any) -> None:
    if claimed != expected:
        raise Rejected(claim, f"{quantity} is {claimed} in the certificate, {expected} in the scenario")


def _check_system(document: Document, spec: dict[str, Any]) -> None:
    n, m, hill = len(document.A), len(document.u_max), spec["kind"] == "clohessy_wiltshire"
    top = spec["thrust_max_N" if hill else "input_max"]
    axes = [f"{axis} thrust" for axis in ("radial", "along-track", "cross-track")]
    pairs = {
        "kind": (document.system_kind, spec["kind"]),
        **({} if document.allocation else {"input limit": (document.u_max, per_axis(top, m))}),
        "disturbance bound": (
            document.w_max,
            spec.get("disturbance_max_m_s2" if hill else "disturbance_max", 0.0),
        ),
        "constant part of the disturbance": (
            document.bias,
            bias if any(bias := spec.get("bias_max_m_s2" if hill else "bias_max", [])) else [],
        ),
        "mass": (document.mass, spec.get("mass_kg", 1.0)),
        "names of inputs": (document.input_names, axes if hill else [f"input {i}" for i in range(m)]),
        "mean motion": (document.mean_motion, spec["mean_motion_rad_s"] if hill else None),
    }
    if not hill:
        pairs |= {key: (getattr(document, key), spec[key]) for key in "ABD"}
    if "C" in spec:
        position = spec["C"]
    else:
        chosen = range(3) if hill else spec.get("position_states", range(max(n // 2, 1)))
        position = [[float(i == j) for j in range(n)] for i in chosen]
    for quantity, (claimed, expected) in {**pairs, "C": (document.C, position)}.items():
        _tightening("system", quantity, claimed, expected)
    C = matrix(document.C)
    if positive_definite(C * C.transpose()) is not True:
        raise Rejected("system", "the coordinates of the position are not independent")


def _check_thrusters(document: Document, scenario: dict[str, Any]) -> None:
    """Check that errors of the thrusters are no smaller than those of the scenario."""
    spec = scenario.get("thrusters", {})
    magnitude, mass, angle, bit = (
        arb(spec.get(key, 0.0))
        for key in ("magnitude_error", "mass_error", "misalignment_deg", "impulse_bit_N_s")
    )
    turn = angle * arb.pi() / 180
    across = turn.sin() * (1 + magnitude)
    if angle > 0 and document.mean_motion is None:
        raise Rejected("system", "a misalignment needs Hill's frame")
    period, layout = arb(document.delta) / document.q, Nozzles.from_document(document)
    carried = spec.get("remainder", "dropped") == "carried"
    if layout is None:
        remainder = spec.get("impulse_bit_N_s", 0.0) * carried
        _tightening("system", "impulse that is carried", document.carried_impulse, remainder)
        along = largest(((magnitude + mass) / (1 - mass), 1 - turn.cos() * (1 - magnitude) / (1 + mass)))
        across /= 1 - mass
        share = across * arb(len(document.u_max) - 1).sqrt()
        bits = [bit / (2 * period) * (2 * share if carried else 1 + along + share)] * len(document.u_max)
        shares = along, across, arb(0)
    else:
        bits, least = layout.dropped(bit, period, carried), layout.max_carried(bit * carried)
        shares = magnitude + (1 - magnitude) * 2 * (turn / 2).sin() ** 2, across, mass
        require(
            "system",
            document.carried_impulse - least * (1 - ROUNDED),
            f"impulses left: {document.carried_impulse}",
        )
    for name, least, value in zip(("along", "across", "of the mass"), shares, document.shares, strict=True):
        require("system", value - least + least * ROUNDED, f"error of the thrusters {name}: {value}")
    constant = spec.get("errors_vary", "always") == "never" and document.allocation is None
    if document.same_shares != (constant and any(x > 0 for x in document.shares)):
        raise Rejected("system", "errors of the thrusters are not as constant as the scenario says")
    for least, value in zip(bits, document.prompt_bits, strict=True):
        require("system", value - least + least * ROUNDED, f"error of the thrusters of the bit: {value}")


def _check_initial_set(document: Document, spec: dict[str, Any]) -> None:
    _tightening("initial_set", "centre", document.center, spec["center"])
    if document.mean_motion is not None and math.hypot(*document.center[:3]) > HILL_RANGE:
        raise Rejected("initial_set", f"starts beyond {HILL_RANGE:g} m: Hill's equations hold near it")
    n, generators = len(document.center), document.generators
    if spec["kind"] == "zonotope":
        _tightening("initial_set", "generators", generators, spec["generators"])
        return
    if spec["kind"] == "box":
        if any(sum(x != 0 for x in g) > 1 for g in generators):
            raise Rejected("initial_set", "a box has generators along the axes")
        extent = [math.fsum(abs(g[i]) for g in generators) for i in range(n)]
        _tightening("initial_set", "half-widths", extent, spec["half_widths"])
        return
    if any(sorted(row) != [0.0] * (n - 1) + [1.0] for row in document.C):
        raise Rejected("initial_set", "a ball needs a position that is a choice of states")
    if len(generators) > MOST_GENERATORS:
        raise Rejected("initial_set", f"a ball has at most {MOST_GENERATORS} generators")
    place = {row.index(1.0) for row in document.C}
    radii = spec["position_radius_m"], spec["velocity_radius_m_s"]
    for states, radius in zip((place, set(range(n)) - place), radii, strict=True):
        block = [g for g in generators if any(g[i] for i in states)]
        if any(g[i] for g in block for i in range(n) if i not in states):
            raise Rejected("initial_set", "a generator mixes position and velocity")
        if not (states and radius):
            continue
        G = matrix([[g[i] for i in sorted(states)] for g in block], len(states)).transpose()
        inside = inner_radius(G) if len(states) <= 3 else _inner_box(G)
        text = f"the ball of radius {radius:g} is not contained"
        require("initial_set", inside - radius * (1 - 1e-9), text)
        reach = max(float(x.mid()) for x in row_sums(G))
        if reach > 2 * radius:
            raise Rejected("initial_set", f"reaches {reach:g} where the ball has the radius {radius:g}")


def _inner_box(G: arb_mat) -> arb:
    """Inner radius of a box; 0 for anything else."""
    along = all(sum(x != 0 for x in g) == 1 for g in G.transpose().tolist())
    return min(row_sums(G)) if along else arb(0)


def _check_sampling(document: Document, scenario: dict[str, Any]) -> None:
    horizon, period = scenario["horizon"], scenario.get("feedback", {}).get("period_s")
    step = horizon["step_s"]
    _tightening("sampling", "step [s]", document.delta, step)
    _times("number of steps", document.steps, step, horizon["duration_s"])
    if period is not None:  # else whichever the certificate rests on
        _times("periods per step", document.q, period, step)


def _times(quantity: str, count: int, part: float, whole: float) -> None:
    """Check that a whole is so many times its part."""
    if not abs(count * part - whole) <= 1e-9 * whole:
        raise Rejected("sampling", f"{quantity}: {count} times {part:g} s is not {whole:g} s")


# -- controllers ------------------------------------------------------------------------------------


def _check_controllers(document: Document, scenario: dict[str, Any]) -> None:
    specs = scenario["experimental"]
    _tightening("controllers", "number of experimental controllers", len(document.laws) - 1, len(specs))
    _tightening("controllers", "name of the safety controller", document.laws[0].name, "safety")
    check_gain(document, document.laws[0], scenario["tracking"])
    for law, spec in zip(document.laws[1:], specs, strict=True):
        _tightening("controllers", "name", law.name, spec["name"])
        _tightening("controllers", f"kind of {law.name}", law.kind, spec["kind"])
        if law.kind in ("any_thrust", "black_box"):
            continue
        if law.kind == "neural":
            top = spec["output_scale_N"]
            _tightening("controllers", "inputs", law.reads, spec.get("inputs", ["error"]))
            _tightening("controllers", "bodies", law.bodies, bodies_of(law.reads, scenario))
            _tightening("controllers", "precision", law.precision, spec.get("precision", "real"))
            ones = [1.0] * len(law.input_scale)
            _tightening("controllers", "scale of the inputs", law.input_scale, spec.get("input_scale", ones))
            tops = top if isinstance(top, list) else [top] * len(document.u_max)
            _tightening("controllers", "scale of the outputs", law.output_scale, tops)
            check_references(document, law, scenario, spec)
            continue
        if spec.get("gain") is not None:
            _tightening("controllers", f"gain of {law.name}", law.gain, spec["gain"])
        else:
            check_gain(document, law, spec)
        check_references(document, law, scenario, spec)
    if document.sampled_bound:
        check_statements(document.sampled_bound, scenario)


def check_statements(claim: dict[str, Any], scenario: dict[str, Any]) -> None:
    """Check that the statements on black boxes answer the scenario's demands, with its seed."""
    boxes = [spec for spec in scenario["experimental"] if spec["kind"] == "black_box"]
    bound = min(spec.get("probability", 0.01) for spec in boxes)
    least = max(spec.get("confidence", 0.999) for spec in boxes)
    if not (claim["probability"] <= bound and claim["confidence"] >= least):
        text = f"{claim['probability']:g} with a confidence of {claim['confidence']:g}"
        raise Rejected("samples", f"{text} is less than was asked for: {bound:g} with {least:g}")
    _tightening("samples", "seed", claim["seed"], scenario.get("simulation", {}).get("seed", 0))


def _check_switching(document: Document, scenario: dict[str, Any]) -> str:
    """Check that who takes over keeps control for the dwell, or to T, and switches are within the cap."""
    rules = switching_rules(scenario)
    dwells = [len(list(group)) for _, group in groupby(document.modes)]
    for i, steps in enumerate(dwells[:-1]):
        if steps < rules["min_dwell"]:
            at = sum(dwells[:i])
            text = f"mode {document.modes[at]} of step {at} ends after {steps} steps"
            raise Rejected("schedule", f"{text}; the scenario's dwell is {rules['min_dwell']} steps")
    count, cap = switches(document.modes), rules["max_switches"]
    if cap is not None and count > cap:
        raise Rejected("schedule", f"{count} switches, the scenario allows {cap}")
    return f"{count} switches, dwell and cap of the scenario kept"
