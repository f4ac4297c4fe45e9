"""Every key of the certificate and of the JSON files of a run folder."""

import math

from ..assumptions import ALLOCATIONS
from .structure import AnyOf, Hexadecimal, Int, Items, Name, Named, OneOf, Real, Shape, Text, every

HEX = Hexadecimal()
AT_LEAST_0 = Hexadecimal(Real(least=0, most=math.inf))
ABOVE_0 = Hexadecimal(Real(above=0, most=math.inf))
UP_TO_1 = Hexadecimal(Real(least=0, most=1))
TEXT, NAME = Text(), Name()
REAL = Real(least=-math.inf, most=math.inf)
NOT_NEGATIVE = Real(least=0, most=math.inf)
SHARE = Real(least=0, most=1)
OPTIONAL = AnyOf((REAL, None))
BOUND = AnyOf((NOT_NEGATIVE, None))  # null for infinity, which bounds nothing
VECTOR = Items(REAL)
MATRIX = Items(VECTOR)
RUN_VERSION = 2  # of schedule.json and summary.json
VERSION_OF_RUN = Int(RUN_VERSION, RUN_VERSION)
GUARANTEE = Text(("proved", "statistical", "none"))
HORIZON = Text(("infinite", "one_period", "none"))


READ = "error|state|time|reference_input|(relative_)?(position|velocity):"
"""What a network reads; of a body, before its name."""


def grid(sizes: str, item: Shape = HEX) -> Shape:
    """Lists in lists; the names of their lengths, ``*`` for any, from the outside."""
    for size in reversed(sizes.split()):
        item = Items(item, size=size.strip("*"))
    return item


_OWN = {"name": NAME, "gain": grid("m n"), "reference_states?": grid("* n"), "reference_inputs?": grid("* m")}

# fmt: off
_LIMITS = {"low": HEX, "high": HEX}
_PART = Hexadecimal(Real(least=0, below=1))
_BITS = AnyOf((AT_LEAST_0, grid("m", AT_LEAST_0)))
_NETWORK = {
    "name": NAME, "precision?": Text(("float32", "float64")),
    "inputs": Items(Text(pattern=f"{READ}.+"), 1, 100),
    "obstacles?": Items({
        "name": NAME, **every(AnyOf((grid("d"), None)), "center_m velocity_m_s"),
        "state": AnyOf((grid("n"), None)), "state_half_widths": AnyOf((grid("n", AT_LEAST_0), None)),
        "thrust_accel_max_m_s2": AT_LEAST_0,
    }, 1, 64),
    "input_scale": grid("*"), "output_scale": grid("m", ABOVE_0),
    "reference_states?": grid("* n"), "reference_inputs?": grid("* m"),
    "layers": Items(OneOf({
        "affine": {"W": grid("* *"), "b": grid("*")}, **every(_LIMITS, "relu tanh sigmoid clip"),
        "diagonal": {"scale": grid("*"), "b": grid("*")},
    }), 1, 1000),
}

CERTIFICATE = {
    **every(TEXT, "format digest guarantee"),
    **every(object, "schema_version assumptions"),
    "scenario": {"name": NAME},
    "artefacts": Named(TEXT),
    "system": {
        "kind": Text(("linear", "clohessy_wiltshire")),
        "A": grid("n n"), "B": grid("n m"), "C": grid("d n"), "D": grid("n p"),
        "input_max": grid("m", ABOVE_0), "input_names": grid("m", NAME),
        "disturbance_max": AT_LEAST_0, "mass": ABOVE_0, "mean_motion": AnyOf((ABOVE_0, None)),
        "bias_max?": grid("p", AT_LEAST_0),
        "estimate_error?": grid("n", AT_LEAST_0),
        "thrusters?": {**every(AT_LEAST_0, "along across"), "mass?": _PART, "bit": _BITS,
                        "constant?": bool},
        "timing?": {**every(HEX, "delay jitter clock"), "missed": Int(), "bit": _BITS,
                    **every(grid("n"), "measured_error state_offset intersample_offset?"),
                    "pulse_thrust?": grid("m"), "pulse_place?": Text(("start", "staggered")),
                    **every(HEX, "carried_impulse? edge?"), "fine?": bool},
        "error_by_step?": grid("K+1 n", AT_LEAST_0),
        "observer?": {"measures": grid("measured n"), "noise": grid("measured"), "gain": grid("n measured"),
                      "after?": grid("missed n measured"), "constant?": grid("measured", AT_LEAST_0),
                      "ages?": Items(Int(), size="ages"), "by_age?": grid("ages n m", AT_LEAST_0),
                      **every(grid("n"), "initial? settled?"), "followed?": Int()},
        "allocation?": {
            "directions": grid("thrusters m"), "limits": grid("thrusters"), "layout": bool,
            "mixes": Items(grid("two m thrusters", AT_LEAST_0), 1),
            "kind?": Text(tuple(ALLOCATIONS)), "multipliers?": grid("* m+1 m"),
        },
        "transients?": Items({"name": NAME, "lasts": ABOVE_0, "pushes?": grid("* m", AT_LEAST_0)}, 1, 8),
    },
    "chaser_radius?": AT_LEAST_0,
    "sampling": {"step": ABOVE_0, **every(Int(1), "steps nodes_per_step")},
    "initial_set": {"center": grid("n"), "generators": grid("* n")},
    "unsafe_sets": Items({
        "name": NAME, "keep_in": bool, "of_state?": bool, "normals": grid("* *"),
        "offsets": grid("covered two *"),
    }, size="sets"),
    "facets": grid("cells sets", Int()),
    "reference": {"states": grid("cells+1 n"), "inputs": grid("cells m")},
    "controllers": Items(OneOf({
        # The safety controller follows the safe reference, the only one that was checked.
        "safety": {"name": NAME, "gain": grid("m n")},
        "affine": _OWN,
        "saturated_affine": _OWN,
        **every({"name": NAME}, "any_thrust black_box"),
        "neural": _NETWORK,
    }), 1),
    "modes": grid("K", Int()),
    "slopes": grid("K", AnyOf((None, grid("q m", UP_TO_1)))),
    "weights?": Items(AnyOf((None, Items(ABOVE_0, 1, 10_000))), 1),
    "feedback_bound?": grid("* m"),
    "recoverable": Text(("polytope", "ball")),
    "horizon": HORIZON,
    "drift?": {
        "horizon": ABOVE_0, "keep_in": bool, "parts": Int(1), "steps": grid("K", AnyOf((None, Items({
            "periods": Int(1), "center": grid("n"), "axes": grid("n n"),
            "facets": Items(Items(Items(Int(), 2, 2), 1)),
        }, 1)))),
    },
    "powered?": {
        **every(AnyOf((HEX, None)), "within budget"),
        "branches": Items({
            "step": Int(1), "inputs": grid("* m"), "facets": grid("* sets", Int()), "tail": grid("n"),
            "tolerance": HEX, "horizon": HORIZON,
        }),
        "steps": grid("K", AnyOf((None, every(Int(), "branch cell")))),
    },
    "samples?": {
        **every(HEX, "probability confidence"), **every(Int(), "flights outside seed attempts"),
        "fits": grid("K", AnyOf((None, grid("q m n+2")))),
    },
    "choices?": {
        "thrust_share?": Hexadecimal(Real(above=0, most=1)), "delta_v_unit?": ABOVE_0,
        "library?": Items({"inputs": grid("K m"), "modes": grid("K", Int())}, most=1000),
    },
}
"""The certificate; `Document` compares the lengths."""

CLAIMED = {
    "kind": GUARANTEE, "horizon": HORIZON, "until_s": OPTIONAL, "reason": TEXT,
    "assumptions": Items(TEXT),
    "goal": {
        "reached": AnyOf((bool, Text(("not_proven",)))), "by_s": OPTIONAL,
        **every(NOT_NEGATIVE, "distance_m tolerance_m delta_v_max_m_s"),
        **every(BOUND, "drift_m_per_orbit velocity_time_s"),
    },
    "upkeep": AnyOf((None, {
        **every(NOT_NEGATIVE, "settled_s until_settled_m_s rate_m_s2"),
        **every(BOUND, "per_orbit_m_s tank_m_s lasts_s"),
    })),
    "estimate?": every(AnyOf((None, Items(NOT_NEGATIVE, 1))), "settled experimental"),
    "abort?": {
        "drift_s": NOT_NEGATIVE, "keep_in": bool, "least_m": OPTIONAL,
        "clear_s": Items(Items(NOT_NEGATIVE, 2, 2)),
        "witness": AnyOf((None, {
            "step": Int(), "unsafe_set": NAME, **every(REAL, "t_s after_s distance_m middle_m"),
        })),
    },
    "fault_attribution?": Items({
        "fault": NAME, "lasts_s": NOT_NEGATIVE, "steps": Items({
            **every(Int(), "step limit_step"), **every(TEXT, "controller limit"),
            **every(REAL, "t_s limit_time_s tightening clearance shortfall"),
        }),
    }),
    "powered_abort?": {
        **every(BOUND, "within_s delta_v_max_m_s"),
        "steps": Items({
            **every(BOUND, "leaves_s by_s delta_v_m_s safe_until_s"),
            "step": Int(), "why": AnyOf((TEXT, None)),
        }),
    },
    "sampled_bound?": {
        **every(SHARE, "probability confidence"), **every(Int(), "flights outside seed attempts"),
    },
}
"""The guarantee as the schedule and the summary repeat it."""

SCHEDULE = {
    "schema_version": VERSION_OF_RUN,
    **every(REAL, "step_s duration_s"),
    "controllers": Items({"mode": Int(), **every(TEXT, "name kind")}),
    "rules": {
        "strategy": TEXT, "min_dwell": Int(1), "max_switches": AnyOf((Int(), None)),
        "weights": VECTOR, "beam": Int(1),
        **every(NOT_NEGATIVE, "delta_v_price switch_price"), "delta_v_max": AnyOf((NOT_NEGATIVE, None)),
    },
    "modes": Items(Int()),
    "switches": Int(),
    "experimental_share": SHARE,
    "share": Named(SHARE),
    "recoverable": TEXT,
    "guarantee": CLAIMED,
    "steps": Items({
        **every(Int(), "step mode"),
        **every(REAL, "t_start_s t_end_s"),
        **every(TEXT, "controller limit"),
        **every(OPTIONAL, "margin limit_time_s tightening clearance"),
    }),
}
"""``schedule.json``."""

REPEATED = "system", "sampling", "controllers"
"""What ``gains.json`` repeats of the certificate, its numbers as decimals."""

GAINS = {"law": TEXT, **every(object, " ".join(REPEATED))}
"""``gains.json``."""

FLOWN = {
    "controller": TEXT,
    "runs": Int(1),
    **every(OPTIONAL, "min_distance_m min_distance_mean_m mean_distance_m"),
    **every(BOUND, "min_ttc_s min_ttc_free_drift_s max_thrust_ratio_safety max_thrust_ratio_experimental"),
    "drift_horizon_s": REAL,
    "experimental_share": Real(least=0, most=1 + 1e-9),  # a sum of times
    **every(Int(), "switches collided_runs"),
    **every(NOT_NEGATIVE, "delta_v_m_s delta_v_max_m_s max_thrust_ratio"),
    "collided": bool,
}
"""Statistics of simulated runs."""

SUMMARY = {
    "schema_version": VERSION_OF_RUN,
    **every(TEXT, "scenario title created"),
    **every(FLOWN, "polaris safety"),  # and each experimental controller alone
    "synthesis": {
        **every(TEXT, "recoverable start_limit"),
        **every(SHARE, "experimental_share share_at_most proven_share?"),
        "worst_flight?": AnyOf(({
            "runs": Int(1), "failure": AnyOf((TEXT, None)), "least_m": OPTIONAL, "leave_sets": SHARE,
            **every(bool, "violated repeats"),
        }, None)),
        "share_bound": {"objective": NOT_NEGATIVE, **every(Int(), "programs demands"), "ended": TEXT},
        "switches": Int(),
        "start_margin": OPTIONAL,
        "planner": Named(object),
        "seconds": object,
    },
    "guarantee": CLAIMED,
    "model_error?": {
        "scenario": TEXT, "covered": bool, **every(NOT_NEGATIVE, "declared_m_s2 bound_m_s2"),
        "parts_m_s2": Named(NOT_NEGATIVE), "satellites_covered_until_s": Named(BOUND),
        "worst": {"controller": TEXT, **every(NOT_NEGATIVE, "time_s radial_m distance_m speed_m_s")},
    },
    "definitions": Named(TEXT),
    "seed": Int(),
    "versions": Named(TEXT),
}
"""``summary.json``."""
# fmt: on
