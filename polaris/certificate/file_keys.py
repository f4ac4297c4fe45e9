"""Every key of the certificate and of the JSON files of a run folder."""

from __future__ import annotations

import math

from .structure import Anything, Either, Flag, Kinds, Named, Null, Real, Rows, Shape, Table, Text, Whole

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

_OWN: dict[str, Shape] = {"own_states": ANY, "own_inputs": ANY}
_LAW: dict[str, Shape] = {"kind": TEXT, "name": TEXT, "gain": ANY}

CERTIFICATE = Table(
    {
        "format": TEXT,
        "schema_version": ANY,
        "digest": TEXT,
        "scenario": Table({"name": ANY}),
        "artefacts": Named(TEXT),
        "system": Table(
            {
                "kind": Text(("linear", "clohessy_wiltshire")),
                "mean_motion": ANY,
                "mass": ANY,
                "A": ANY,
                "B": ANY,
                "C": ANY,
                "D": ANY,
                "input_max": ANY,
                "disturbance_max": ANY,
                "input_names": ANY,
            }
        ),
        "sampling": Table({"kind": ANY, "step": ANY, "steps": ANY, "nodes_per_step": ANY}),
        "initial_set": Table({"center": ANY, "generators": ANY}),
        "unsafe_sets": Rows(Table({"name": ANY, "keep_in": Flag(), "normals": ANY, "offsets": ANY})),
        "facets": ANY,
        "reference": Table({"states": ANY, "inputs": ANY}),
        "controllers": Rows(
            Kinds(
                {
                    # The safety controller follows the safe reference, the only one that was checked.
                    "safety": Table(_LAW),
                    "affine": Table(_LAW, _OWN),
                    "saturated_affine": Table(_LAW, _OWN),
                    "any_thrust": Table({"kind": TEXT, "name": TEXT}),
                }
            ),
            1,
        ),
        "schedule": Table({"modes": ANY, "margins": ANY}),
        "error_bounds": Table({"per_step": ANY, "settled": ANY}),
        "thrust": Table({"peak": ANY}),
        "recoverable": Table({"kind": ANY, "weight": ANY, "radius": ANY}),
        "enclosures": Table({"center": ANY, "half_widths": ANY, "lower": ANY, "upper": ANY, "slopes": ANY}),
        "end": Table({"horizon": ANY, "until": ANY, "reason": TEXT}),
        "guarantee": TEXT,
        "assumptions": ANY,
    }
)
"""The certificate; `Document` decodes what stands under the keys."""

CLAIMED = Table(
    {"kind": GUARANTEE, "horizon": HORIZON, "until_s": OPTIONAL, "reason": TEXT, "assumptions": Rows(TEXT)}
)
"""The guarantee as the schedule and the summary repeat it."""

SCHEDULE = Table(
    {
        "schema_version": ONE,
        "step_s": REAL,
        "duration_s": REAL,
        "controllers": Rows(Table({"mode": Whole(), "name": TEXT, "kind": TEXT})),
        "rules": Table(
            {
                "strategy": TEXT,
                "min_dwell": Whole(1),
                "max_switches": Either((Whole(), Null())),
                "weights": VECTOR,
                "beam": Whole(1),
            }
        ),
        "modes": Rows(Whole()),
        "switches": Whole(),
        "experimental_share": SHARE,
        "share": Named(SHARE),
        "recoverable": TEXT,
        "guarantee": CLAIMED,
        "steps": Rows(
            Table(
                {
                    "step": Whole(),
                    "t_start_s": REAL,
                    "t_end_s": REAL,
                    "mode": Whole(),
                    "controller": TEXT,
                    "margin": OPTIONAL,
                    "limit": TEXT,
                    "limit_time_s": OPTIONAL,
                    "need": OPTIONAL,
                    "room": OPTIONAL,
                }
            )
        ),
    }
)
"""``schedule.json``."""

GAINS = Table(
    {
        "law": TEXT,
        "system": Table(
            {
                "A": MATRIX,
                "B": MATRIX,
                "C": MATRIX,
                "D": MATRIX,
                "input_max": VECTOR,
                "disturbance_max": NOT_NEGATIVE,
                "mass_kg": REAL,
            }
        ),
        "feedback": Table({"sampled": Flag(), "node_spacing_s": REAL, "nodes_per_step": Whole(1)}),
        "controllers": Rows(
            Table(
                {"mode": Whole(), "name": TEXT, "kind": TEXT},
                {"gain": MATRIX, "clips": Flag(), "own_states": MATRIX, "own_inputs": MATRIX},
            )
        ),
        "error_bounds": Table(
            {
                "method": TEXT,
                "weight": MATRIX,
                "beta_1_s": OPTIONAL,
                "gamma": BOUND,
                "gain": BOUND,
                "gamma_position": BOUND,
                "gain_position": BOUND,
                "gamma_input": Rows(BOUND),
                "gain_input": Rows(BOUND),
            }
        ),
    }
)
"""``gains.json``."""

FLOWN = Table(
    {
        "controller": TEXT,
        "runs": Whole(1),
        "min_distance_m": OPTIONAL,
        "min_distance_mean_m": OPTIONAL,
        "mean_distance_m": OPTIONAL,
        "min_ttc_s": BOUND,
        "min_ttc_free_drift_s": BOUND,
        "drift_horizon_s": REAL,
        "experimental_share": Real(least=0, most=1 + 1e-9),  # a sum of times
        "switches": Whole(),
        "delta_v_m_s": NOT_NEGATIVE,
        "delta_v_max_m_s": NOT_NEGATIVE,
        "collided": Flag(),
        "collided_runs": Whole(),
        "max_thrust_ratio": NOT_NEGATIVE,
        "max_thrust_ratio_safety": BOUND,
        "max_thrust_ratio_experimental": BOUND,
    }
)
"""Statistics of simulated runs."""

SUMMARY = Table(
    {
        "schema_version": ONE,
        "scenario": TEXT,
        "title": TEXT,
        "polaris": FLOWN,
        "safety": FLOWN,
        "synthesis": Table(
            {
                "recoverable": TEXT,
                "experimental_share": SHARE,
                "switches": Whole(),
                "start_margin": OPTIONAL,
                "start_limit": TEXT,
                "planner": Named(ANY),
                "seconds": ANY,
            }
        ),
        "guarantee": CLAIMED,
        "definitions": Named(TEXT),
        "seed": Whole(),
        "versions": Named(TEXT),
        "created": TEXT,
    },
    {"experimental": FLOWN},
)
"""``summary.json``."""
