"""Every key that a scenario file may have, with its type and range.

A key that stands here is either compared with the certificate or known to be no claim (`docs/certificate.md`
lists which). What does not stand here is refused: a checker that passes over a key it does not know has
checked another scenario. Written by hand on purpose; a test compares it with the scenario models.
"""

from __future__ import annotations

import math
from typing import Any

from .structure import Either, Flag, Kinds, Real, Rows, Shape, Table, Text, Whole, conform
from .verdict import Rejected

STEPS = 100_000
"""Most steps of a horizon."""

NAME = Text(pattern=r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")
NUMBER = Real()
NOT_NEGATIVE = Real(least=0)
POSITIVE = Real(above=0)
MASS = Real(least=1e-3, most=1e7)
VECTOR = Rows(NUMBER, 1, 100)
WIDTHS = Rows(NOT_NEGATIVE, 1, 100)
OPEN_WIDTHS = Rows(Real(least=0, most=math.inf), 1, 100)
LIMITS = Rows(POSITIVE, 1, 100)
MATRIX = Rows(VECTOR, 1, 1000, even=True)
WEIGHT = Either((VECTOR, MATRIX))
PER_AXIS = Either((POSITIVE, LIMITS))
SHARE = Real(least=0, below=1)
WORTH = Real(above=0, most=1e6)
FACETS = Whole(3, 64)


def _kind(name: str) -> dict[str, Shape]:
    return {"kind": Text((name,))}


_REFERENCE = Kinds(
    {
        "shared": Table(_kind("shared")),
        "setpoint": Table(_kind("setpoint") | {"state": VECTOR}),
        "nmt": Table(
            _kind("nmt") | {"semi_minor_m": NOT_NEGATIVE},
            {"phase_rad": NUMBER, "cross_track_m": NOT_NEGATIVE, "cross_phase_rad": NUMBER},
        ),
        "unaware": Table(_kind("unaware")),
    }
)


def _affine(kind: str) -> Table:
    optional: dict[str, Shape] = {"Q": WEIGHT, "R": WEIGHT, "gain": MATRIX}
    optional |= {"reference": _REFERENCE, "weight": WORTH}
    return Table(_kind(kind) | {"name": NAME}, optional)


_START = {"center": VECTOR}

SCENARIO = Table(
    {
        "schema_version": Whole(1, 1),
        "name": NAME,
        "title": Text(pattern=r"(?s:.{1,200})"),
        "system": Kinds(
            {
                "clohessy_wiltshire": Table(
                    _kind("clohessy_wiltshire")
                    | {
                        "mean_motion_rad_s": Real(above=0, most=0.01),
                        "mass_kg": MASS,
                        "thrust_max_N": PER_AXIS,
                    },
                    {"disturbance_max_m_s2": NOT_NEGATIVE},
                ),
                "linear": Table(
                    _kind("linear") | {"A": MATRIX, "B": MATRIX, "D": MATRIX, "input_max": PER_AXIS},
                    {
                        "disturbance_max": NOT_NEGATIVE,
                        "position_states": Rows(Whole(0, 99), 1, 3),
                        "C": MATRIX,
                        "mass_kg": MASS,
                    },
                ),
            }
        ),
        "initial_set": Kinds(
            {
                "box": Table(_kind("box") | _START | {"half_widths": WIDTHS}),
                "ball": Table(
                    _kind("ball")
                    | _START
                    | {"position_radius_m": NOT_NEGATIVE, "velocity_radius_m_s": NOT_NEGATIVE}
                ),
                "zonotope": Table(_kind("zonotope") | _START | {"generators": MATRIX}),
            }
        ),
        "horizon": Table({"duration_s": POSITIVE, "step_s": POSITIVE}),
        "tracking": Table(
            {"Q": WEIGHT, "R": WEIGHT},
            {
                "bound": Text(("envelope", "lyapunov")),
                "weight": Either((Text(("auto", "identity")), LIMITS)),
            },
        ),
        "goal": Kinds(
            {
                "elliptical_nmt": Table(
                    _kind("elliptical_nmt")
                    | {"inner_semi_minor_m": NOT_NEGATIVE, "outer_semi_minor_m": POSITIVE},
                    {"sides": Whole(4, 64), "cross_track_max_m": POSITIVE},
                ),
                "linear_nmt": Table(
                    _kind("linear_nmt") | {"amplitude_max_m": POSITIVE}, {"along_track_m": NUMBER}
                ),
                "stationary": Table(_kind("stationary") | {"state": VECTOR}),
                "box": Table(_kind("box") | {"center": VECTOR, "half_widths": OPEN_WIDTHS}),
            }
        ),
        "experimental": Rows(
            Kinds(
                {
                    "affine": _affine("affine"),
                    "saturated_affine": _affine("saturated_affine"),
                    "any_thrust": Table(_kind("any_thrust") | {"name": NAME}, {"weight": WORTH}),
                }
            ),
            1,
            8,
        ),
    },
    {
        "description": Text(pattern=r"(?s:.{0,5000})"),
        "orbit": Table(
            {
                "radius_deviation_max_m": NOT_NEGATIVE,
                "radial_rate_max_m_s": NOT_NEGATIVE,
                "rate_deviation_max": Real(least=0, most=0.1),
                "density_kg_m3": NOT_NEGATIVE,
                "scale_height_m": POSITIVE,
                "ballistic_coefficient_m2_kg": NOT_NEGATIVE,
                "ballistic_difference_max_m2_kg": NOT_NEGATIVE,
            },
            {
                "inclination_max_deg": Real(least=0, most=90),
                "other_acceleration_max_m_s2": NOT_NEGATIVE,
            },
        ),
        "feedback": Kinds(
            {
                "continuous": Table(_kind("continuous")),
                "sampled": Table(_kind("sampled") | {"period_s": POSITIVE}),
            }
        ),
        "recoverable": Table({}, {"kind": Text(("polytope", "ball", "time_varying_ball", "paper_ball"))}),
        "planner": Table(
            {},
            {
                "objective": Text(("margin_then_fuel", "distance", "fuel")),
                "extra_margin_m": NOT_NEGATIVE,
                "thrust_reserve": SHARE,
                "solver": Text(("facets", "highs", "gurobi")),
                "max_linear_programs": Whole(1, 10**9),
                "max_nodes": Whole(1, 10**9),
                "time_limit_s": Real(above=0, most=1e6),
                "gap": SHARE,
            },
        ),
        "obstacles": Rows(
            Kinds(
                {
                    "box": Table(
                        _kind("box") | {"name": NAME, "center_m": VECTOR, "half_widths_m": WIDTHS},
                        {"velocity_m_s": VECTOR},
                    ),
                    "ball": Table(
                        _kind("ball") | {"name": NAME, "center_m": VECTOR, "radius_m": POSITIVE},
                        {"velocity_m_s": VECTOR, "facets": FACETS},
                    ),
                    "polytope": Table(
                        _kind("polytope") | {"name": NAME, "normals": MATRIX, "offsets_m": VECTOR},
                        {"velocity_m_s": VECTOR, "unbounded": Flag()},
                    ),
                    "satellite": Table(
                        _kind("satellite")
                        | {"name": NAME, "state": VECTOR, "state_half_widths": WIDTHS, "radius_m": POSITIVE},
                        {"thrust_accel_max_m_s2": NOT_NEGATIVE, "facets": FACETS},
                    ),
                }
            ),
            0,
            64,
        ),
        "keep_in": Rows(
            Kinds(
                {
                    "polytope": Table(
                        _kind("polytope") | {"name": NAME, "normals": MATRIX, "offsets_m": VECTOR}
                    ),
                    "cone": Table(
                        _kind("cone")
                        | {
                            "name": NAME,
                            "apex_m": VECTOR,
                            "axis": VECTOR,
                            "half_angle_deg": Real(least=0.1, most=89),
                        },
                        {"facets": FACETS, "length_m": POSITIVE},
                    ),
                }
            ),
            0,
            16,
        ),
        "schedule": Table(
            {},
            {
                "strategy": Text(("greedy", "look_ahead")),
                "min_dwell_steps": Whole(1, STEPS),
                "max_switches": Whole(0),
                "beam": Whole(1, 1000),
            },
        ),
        "simulation": Table({}, {"runs": Whole(1, 1_000_000), "seed": Whole(0, 2**63 - 1)}),
    },
)
"""The whole file."""


def check_keys(scenario: Any) -> None:
    """Refuse a scenario with a key, a type or a number that the format does not have.

    Raises
    ------
    Rejected
        Naming the claim ``scenario``.
    """
    conform(scenario, SCENARIO, "scenario", "scenario.toml")
    if {"C", "position_states"} <= set(scenario["system"]):
        raise Rejected("scenario", "system gives both C and position_states")
    for i, spec in enumerate(scenario["experimental"]):
        if spec["kind"] != "any_thrust" and not ("gain" in spec) == ("Q" not in spec) == ("R" not in spec):
            raise Rejected("scenario", f"experimental[{i}] must have either a gain or Q and R")
    bodies = [*scenario.get("obstacles", ()), *scenario.get("keep_in", ())]
    for spec in bodies:
        if spec["kind"] == "polytope" and len(spec["normals"]) != len(spec["offsets_m"]):
            raise Rejected("scenario", f"{spec['name']} must have one offset for every normal")
    for what, specs in (("unsafe sets", bodies), ("controllers", scenario["experimental"])):
        names = [spec["name"] for spec in specs]
        if len(set(names)) < len(names):
            raise Rejected("scenario", f"two {what} have the same name")
        if not names:
            raise Rejected("scenario", f"there are no {what}")
    for name in {"safety", "polaris"} & {spec["name"] for spec in scenario["experimental"]}:
        raise Rejected("scenario", f"an experimental controller is called {name}, a name of the results")
