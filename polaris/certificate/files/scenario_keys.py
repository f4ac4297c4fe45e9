"""Every key that a scenario file may have, with its type and range.

A key that stands here is either compared with the certificate or known to be no claim (`docs/certificate.md`
lists which). What does not stand here is refused: a checker that passes over a key it does not know has
checked another scenario. Written by hand on purpose; a test compares it with the scenario models.
"""

import math
from typing import Any

from ..assumptions import ALLOCATIONS
from ..kernel.verdict import Rejected
from .file_keys import READ
from .structure import AnyOf, Int, Items, OneOf, Real, Text, conform, every

STEPS = 100_000  # most steps of a horizon

NAME = Text(pattern=r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")
NUMBER = Real()
NOT_NEGATIVE = Real(least=0)
POSITIVE = Real(above=0)
MASS = Real(least=1e-3, most=1e7)
VECTOR = Items(NUMBER, 1, 100)
WIDTHS = Items(NOT_NEGATIVE, 1, 100)
OPEN_WIDTHS = Items(Real(least=0, most=math.inf), 1, 100)
LIMITS = Items(POSITIVE, 1, 100)
MATRIX = Items(VECTOR, 1, 1000, even=True)
WEIGHT = AnyOf((VECTOR, MATRIX))
PER_AXIS = AnyOf((POSITIVE, LIMITS))
SIZES = AnyOf((NOT_NEGATIVE, WIDTHS))
SHARE = Real(least=0, below=1)
WORTH = Real(above=0, most=1e6)
FACETS = Int(3, 64)


# fmt: off
_REFERENCE = OneOf({
    "shared": {},
    "setpoint": {"state": VECTOR},
    "nmt": {"semi_minor_m": NOT_NEGATIVE, "phase_rad?": NUMBER,
            "cross_track_m?": NOT_NEGATIVE, "cross_phase_rad?": NUMBER},
    "unaware": {},
})
_AFFINE = {
    "name": NAME, "Q?": WEIGHT, "R?": WEIGHT, "gain?": MATRIX, "reference?": _REFERENCE, "weight?": WORTH,
}
_ESTIMATE = {**every(SIZES, "position_error_m? velocity_error_m_s?"), "state_error?": WIDTHS}
_SIGHT = {"range_error_m?": NOT_NEGATIVE, "bearing_error_deg?": Real(least=0, most=45), "within_m?": PER_AXIS}
_GOAL = every(POSITIVE, "tolerance_m? velocity_tolerance_m_s?")
_ORBITS: dict[str, dict[str, Any]] = {
    "elliptical_nmt": {**_GOAL, "inner_semi_minor_m": NOT_NEGATIVE, "outer_semi_minor_m": POSITIVE,
                       "sides?": Int(4, 64), "cross_track_max_m?": POSITIVE},
    "linear_nmt": {**_GOAL, "amplitude_max_m": POSITIVE, "along_track_m?": NUMBER},
    "stationary": {**_GOAL, "state": VECTOR},
}
_BODY = {"name": NAME, "velocity_m_s?": VECTOR}
_WINDOW = {"from_s?": NOT_NEGATIVE, "until_s?": POSITIVE}
_STATES = {"name": NAME, "rows": MATRIX, "bounds": VECTOR, **_WINDOW}
_POLYTOPE = {"name": NAME, "normals": MATRIX, "offsets_m": VECTOR}

SCENARIO = {
    "schema_version": Int(1, 1),
    "name": NAME,
    "title": Text(pattern=r"(?s:.{1,200})"),
    "description?": Text(pattern=r"(?s:.{0,5000})"),
    "system": OneOf({
        "clohessy_wiltshire": {"mean_motion_rad_s": Real(above=0, most=0.01), "mass_kg": MASS,
                               "thrust_max_N": PER_AXIS, "disturbance_max_m_s2?": NOT_NEGATIVE,
                               "bias_max_m_s2?": WIDTHS},
        "linear": {**every(MATRIX, "A B D C?"), "input_max": PER_AXIS, "disturbance_max?": NOT_NEGATIVE,
                   "bias_max?": WIDTHS,
                   "position_states?": Items(Int(0, 99), 1, 3), "mass_kg?": MASS},
    }),
    "orbit?": {
        **every(NOT_NEGATIVE, "radius_deviation_max_m radial_rate_max_m_s density_kg_m3"
                " ballistic_coefficient_m2_kg ballistic_difference_max_m2_kg other_acceleration_max_m_s2?"),
        "rate_deviation_max": Real(least=0, most=0.1),
        "scale_height_m": POSITIVE,
        "inclination_max_deg?": Real(least=0, most=90),
        "eccentricity_max?": Real(least=0, most=0.1),
        "elements?": {
            "epoch": Text(pattern=r"(?s:.{1,40})"), "semi_major_axis_m": POSITIVE,
            "eccentricity": Real(least=0, below=0.2), "inclination_deg": Real(least=0, most=180),
            **every(Real(least=-360, most=360), "ascending_node_deg perigee_deg true_anomaly_deg"),
            "frame?": Text(("EME2000", "GCRF", "ICRF", "J2000", "TEME", "TOD", "MOD")),
            "time_system?": Text(("UTC", "TAI", "TT", "TDB", "GPS")),
        },
    },
    "navigation?": {
        **_ESTIMATE, **_SIGHT,
        "phases?": Items({"from_s": POSITIVE, **_ESTIMATE, **_SIGHT}, 0, 64),
        "measurement?": {**every(PER_AXIS, "position_error_m? velocity_error_m_s?"), "matrix?": MATRIX,
                         **_SIGHT, "error?": LIMITS, "initial?": _ESTIMATE,
                         "constant_share?": Real(least=0, most=1)},
    },
    "thrusters?": {
        **every(Real(least=0, below=0.5), "magnitude_error? mass_error?"),
        **every(NOT_NEGATIVE, "impulse_bit_N_s? rise_s? fall_s?"),
        "misalignment_deg?": Real(least=0, most=45), "directions?": MATRIX, "thrust_max_N?": PER_AXIS,
        "pulse?": Text(("held", "centred", "start", "staggered")), "remainder?": Text(("dropped", "carried")),
        "allocation?": Text(tuple(ALLOCATIONS)), "resolution?": Text(("bit", "continuous")),
        "errors_vary?": Text(("always", "never")),
    },
    "timing?": {
        "delay_s?": Real(least=0, most=1e4), "missed_periods?": Int(0, 1000),
        **every(NOT_NEGATIVE, "jitter_s? clock_error_s?"),
    },
    "faults?": Items(OneOf({
        "stuck_off": {"isolation_s?": NOT_NEGATIVE}, "stuck_on": {"isolation_s": POSITIVE},
        "loss": {"share": Real(above=0, below=1), "isolation_s?": NOT_NEGATIVE},
        "navigation_lost": {"lasts_s": Real(above=0, most=1e4)},
    }), 0, 8),
    "chaser?": {"radius_m": NOT_NEGATIVE},
    "tank?": {"delta_v_m_s": POSITIVE},
    "abort?": {
        "drift_orbits?": Real(above=0, most=100), "drift_s?": POSITIVE, **every(bool, "required? keep_in?"),
        "orbit?": OneOf({"goal": {}, **_ORBITS}), **every(POSITIVE, "within_s? delta_v_max_m_s?"),
    },
    "feedback?": {"period_s?": POSITIVE},
    "initial_set": OneOf({
        "box": {"center": VECTOR, "half_widths": WIDTHS},
        "ball": {"center": VECTOR, **every(NOT_NEGATIVE, "position_radius_m velocity_radius_m_s")},
        "zonotope": {"center": VECTOR, "generators": MATRIX},
    }),
    "horizon": every(POSITIVE, "duration_s step_s"),
    "tracking": {
        "Q": WEIGHT, "R": WEIGHT, "bound?": Text(("envelope", "lyapunov")),
        "thrust_share?": Real(above=0, most=1),
        "weight?": AnyOf((Text(("auto", "identity")), LIMITS)),
    },
    "recoverable?": {
        "kind?": Text(("polytope", "ball")),
        "recourse?": Text(("replan", "none")),
    },
    "goal": OneOf({**_ORBITS, "box": {**_GOAL, "center": VECTOR, "half_widths": OPEN_WIDTHS}}),
    "planner?": {
        "objective?": Text(("margin_then_fuel", "distance", "fuel")),
        "extra_margin_m?": NOT_NEGATIVE,
        "solver?": Text(("facets", "highs", "gurobi")),
        **every(Int(1, 10**9), "max_linear_programs? max_nodes?"),
        "time_limit_s?": Real(above=0, most=1e6),
        **every(SHARE, "thrust_reserve? gap?"),
    },
    "obstacles?": Items(OneOf({
        "box": {**_BODY, "center_m": VECTOR, "half_widths_m": WIDTHS},
        "ball": {**_BODY, "center_m": VECTOR, "radius_m": POSITIVE, "facets?": FACETS},
        "polytope": {**_BODY, **_POLYTOPE, "unbounded?": bool},
        "satellite": {"name": NAME, "state": VECTOR, "state_half_widths": WIDTHS, "radius_m": POSITIVE,
                      "thrust_accel_max_m_s2?": NOT_NEGATIVE, "facets?": FACETS},
        "states": _STATES,
    }), 0, 64),
    "keep_in?": Items(OneOf({
        "polytope": _POLYTOPE,
        "cone": {"name": NAME, "apex_m": VECTOR, "axis": VECTOR, "half_angle_deg": Real(least=0.1, most=89),
                 "facets?": FACETS, "length_m?": POSITIVE},
        "states": _STATES,
        "speed": {"name": NAME, "max_m_s": PER_AXIS, "per_distance_1_s?": NOT_NEGATIVE, "facets?": FACETS,
                  "towards?": MATRIX, **_WINDOW},
        "turning": {**_POLYTOPE, "rate_rad_s": NUMBER, "until_s": POSITIVE, "axis?": VECTOR,
                    **every(NOT_NEGATIVE, "rate_error_rad_s? from_s?"),
                    "angle_error_deg?": Real(least=0, most=45)},
        "speed_polygon": {"name": NAME, "max_m_s": POSITIVE, "sides?": Int(3, 64),
                          "axes?": Items(Int(0, 99), 2, 2), **_WINDOW},
    }), 0, 16),
    "experimental": Items(OneOf({
        "affine": _AFFINE,
        "saturated_affine": _AFFINE,
        "any_thrust": {"name": NAME, "weight?": WORTH},
        "black_box": {"name": NAME, "weight?": WORTH, "probability?": Real(least=1e-5, most=0.5),
                      "confidence?": Real(least=0.5, most=1 - 1e-9), "memory?": bool},
        "neural": {"name": NAME, "path": Text(pattern=r"(?s:.{1,1000})\.onnx"), "input_scale?": VECTOR,
                   "inputs?": Items(Text(pattern=READ + NAME.pattern), 1, 100),
                   "precision?": Text(("real", "float32", "float64")), "output_scale_N": PER_AXIS,
                   "reference?": _REFERENCE, "weight?": WORTH},
    }), 1, 8),
    "schedule?": {
        "strategy?": Text(("greedy", "look_ahead")),
        "min_dwell_steps?": Int(1, STEPS),
        "max_switches?": Int(0),
        "beam?": Int(1, 1000),
        "bound_programs?": Int(0, 10**9),
        **every(NOT_NEGATIVE, "delta_v_price? switch_price?"), "delta_v_max_m_s?": POSITIVE,
    },
    "simulation?": {"runs?": Int(1, 1_000_000), "seed?": Int(0, 2**63 - 1)},
}
# fmt: on
"""The whole file."""


def check_keys(scenario: Any) -> None:
    """Refuse a scenario with a key, a type or a number that the format does not have."""
    conform(scenario, SCENARIO, "scenario", "scenario.toml")
    if {"C", "position_states"} <= set(scenario["system"]):
        raise Rejected("scenario", "system gives both C and position_states")
    for i, spec in enumerate(scenario["experimental"]):
        linear = spec["kind"] in ("affine", "saturated_affine")
        if linear and not ("gain" in spec) == ("Q" not in spec) == ("R" not in spec):
            raise Rejected("scenario", f"experimental[{i}] must have either a gain or Q and R")
    bodies = [*scenario.get("obstacles", ()), *scenario.get("keep_in", ())]
    for spec in bodies:
        rows, bounds = ("rows", "bounds") if spec["kind"] == "states" else ("normals", "offsets_m")
        if rows in spec and len(spec[rows]) != len(spec[bounds]):
            raise Rejected("scenario", f"{spec['name']} must have one number in {bounds} for each of {rows}")
    for kind, specs in (("unsafe sets", bodies), ("controllers", scenario["experimental"])):
        names = [spec["name"] for spec in specs]
        if len(set(names)) < len(names):
            raise Rejected("scenario", f"two {kind} have the same name")
        if not names:
            raise Rejected("scenario", f"there are no {kind}")
    for name in {"safety", "polaris"} & {spec["name"] for spec in scenario["experimental"]}:
        raise Rejected("scenario", f"an experimental controller is called {name}, a name of the results")
