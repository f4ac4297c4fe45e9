"""Every key of the certificate and of the JSON files of a run folder."""

from __future__ import annotations

import math

from .structure import Anything, Either, Flag, Named, Null, Real, Rows, Text, Whole, every, keyed, kinds

ANY = Anything()
TEXT = Text()
REAL = Real(least=-math.inf, most=math.inf)
NOT_NEGATIVE = Real(least=0, most=math.inf)
SHARE = Real(least=0, most=1)
OPTIONAL = Either((REAL, Null()))
BOUND = Either((NOT_NEGATIVE, Null()))
"""Null for infinity, which bounds nothing."""
VECTOR = Rows(REAL)
MATRIX = Rows(VECTOR)
ONE = Whole(1, 1)
GUARANTEE = Text(("proved", "none"))
HORIZON = Text(("infinite", "one_period", "none"))

_OWN = {**every(ANY, "gain own_states? own_inputs?"), "name": TEXT}

# fmt: off
CERTIFICATE = keyed({
    **every(TEXT, "format digest guarantee"),
    **every(ANY, "schema_version facets assumptions"),
    "scenario": keyed({"name": ANY}),
    "artefacts": Named(TEXT),
    "system": keyed({
        "kind": Text(("linear", "clohessy_wiltshire")),
        **every(ANY, "mean_motion mass A B C D input_max disturbance_max input_names"),
    }),
    "sampling": keyed(every(ANY, "kind step steps nodes_per_step")),
    "initial_set": keyed(every(ANY, "center generators")),
    "unsafe_sets": Rows(keyed({**every(ANY, "name normals offsets"), "keep_in": Flag()})),
    "reference": keyed(every(ANY, "states inputs")),
    "controllers": Rows(kinds({
        # The safety controller follows the safe reference, the only one that was checked.
        "safety": {"name": TEXT, "gain": ANY},
        "affine": _OWN,
        "saturated_affine": _OWN,
        "any_thrust": {"name": TEXT},
    }), 1),
    "schedule": keyed(every(ANY, "modes margins")),
    "error_bounds": keyed(every(ANY, "per_step settled")),
    "thrust": keyed({"peak": ANY}),
    "recoverable": keyed(every(ANY, "kind weight radius")),
    "enclosures": keyed(every(ANY, "center half_widths lower upper slopes")),
    "end": keyed({**every(ANY, "horizon until"), "reason": TEXT}),
})
"""The certificate; `Document` decodes what stands under the keys."""

CLAIMED = keyed(
    {"kind": GUARANTEE, "horizon": HORIZON, "until_s": OPTIONAL, "reason": TEXT, "assumptions": Rows(TEXT)}
)
"""The guarantee as the schedule and the summary repeat it."""

SCHEDULE = keyed({
    "schema_version": ONE,
    **every(REAL, "step_s duration_s"),
    "controllers": Rows(keyed({"mode": Whole(), **every(TEXT, "name kind")})),
    "rules": keyed({
        "strategy": TEXT, "min_dwell": Whole(1), "max_switches": Either((Whole(), Null())),
        "weights": VECTOR, "beam": Whole(1),
    }),
    "modes": Rows(Whole()),
    "switches": Whole(),
    "experimental_share": SHARE,
    "share": Named(SHARE),
    "recoverable": TEXT,
    "guarantee": CLAIMED,
    "steps": Rows(keyed({
        **every(Whole(), "step mode"),
        **every(REAL, "t_start_s t_end_s"),
        **every(TEXT, "controller limit"),
        **every(OPTIONAL, "margin limit_time_s need room"),
    })),
})
"""``schedule.json``."""

GAINS = keyed({
    "law": TEXT,
    "system": keyed({
        **every(MATRIX, "A B C D"), "input_max": VECTOR, "disturbance_max": NOT_NEGATIVE, "mass_kg": REAL,
    }),
    "feedback": keyed({"sampled": Flag(), "node_spacing_s": REAL, "nodes_per_step": Whole(1)}),
    "controllers": Rows(keyed({
        "mode": Whole(), **every(TEXT, "name kind"), "clips?": Flag(),
        **every(MATRIX, "gain? own_states? own_inputs?"),
    })),
    "error_bounds": keyed({
        "method": TEXT,
        "weight": MATRIX,
        "beta_1_s": OPTIONAL,
        **every(BOUND, "gamma gain gamma_position gain_position"),
        **every(Rows(BOUND), "gamma_input gain_input"),
    }),
})
"""``gains.json``."""

FLOWN = keyed({
    "controller": TEXT,
    "runs": Whole(1),
    **every(OPTIONAL, "min_distance_m min_distance_mean_m mean_distance_m"),
    **every(BOUND, "min_ttc_s min_ttc_free_drift_s max_thrust_ratio_safety max_thrust_ratio_experimental"),
    "drift_horizon_s": REAL,
    "experimental_share": Real(least=0, most=1 + 1e-9),  # a sum of times
    **every(Whole(), "switches collided_runs"),
    **every(NOT_NEGATIVE, "delta_v_m_s delta_v_max_m_s max_thrust_ratio"),
    "collided": Flag(),
})
"""Statistics of simulated runs."""

SUMMARY = keyed({
    "schema_version": ONE,
    **every(TEXT, "scenario title created"),
    **every(FLOWN, "polaris safety experimental?"),
    "synthesis": keyed({
        **every(TEXT, "recoverable start_limit"),
        "experimental_share": SHARE,
        "switches": Whole(),
        "start_margin": OPTIONAL,
        "planner": Named(ANY),
        "seconds": ANY,
    }),
    "guarantee": CLAIMED,
    "definitions": Named(TEXT),
    "seed": Whole(),
    "versions": Named(TEXT),
})
"""``summary.json``."""
# fmt: on
