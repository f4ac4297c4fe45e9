"""Table of scenario keys by their demand on a run: checked under a claim, not checked, or nothing.

A test walks the format: every key stands in one of the three tables, by the table of the file that it is in.
One that is new belongs to a check, or to what `polaris verify` prints as not checked.
"""

from collections.abc import Iterator, Mapping
from typing import Any

CHECKED = {
    "scenario": {"": "schema_version"},
    "system": {
        "": "name",
        "system": "kind mean_motion_rad_s mass_kg thrust_max_N A B C D disturbance_max_m_s2 input_max"
        " disturbance_max position_states bias_max_m_s2 bias_max",
        "navigation": "position_error_m velocity_error_m_s state_error range_error_m bearing_error_deg",
        "navigation.phases": "from_s position_error_m velocity_error_m_s state_error range_error_m"
        " bearing_error_deg",
        "navigation.measurement": "position_error_m velocity_error_m_s matrix error range_error_m"
        " bearing_error_deg constant_share",
        "navigation.measurement.initial": "position_error_m velocity_error_m_s state_error",
        "thrusters": "errors_vary magnitude_error misalignment_deg mass_error impulse_bit_N_s remainder pulse"
        " resolution rise_s fall_s directions thrust_max_N allocation",
        "timing": "delay_s jitter_s missed_periods clock_error_s",
        "faults": "kind share isolation_s lasts_s",
    },
    "unsafe_sets": {
        "chaser": "radius_m",
        "navigation": "within_m",
        "navigation.phases": "within_m",
        "navigation.measurement": "within_m",
        "obstacles": "kind name center_m half_widths_m velocity_m_s radius_m facets normals offsets_m"
        " state state_half_widths thrust_accel_max_m_s2 rows bounds from_s until_s",
        "keep_in": "kind name normals offsets_m apex_m axis half_angle_deg facets length_m rows bounds from_s"
        " until_s max_m_s per_distance_1_s towards sides axes rate_rad_s rate_error_rad_s angle_error_deg",
    },
    "initial_set": {
        "initial_set": "kind center half_widths position_radius_m velocity_radius_m_s generators"
    },
    "sampling": {"feedback": "period_s", "horizon": "duration_s step_s"},
    "controllers": {
        "tracking": "Q R",
        "experimental": "kind name Q R gain path inputs input_scale output_scale_N precision",
        "experimental.reference": "kind state semi_minor_m phase_rad cross_track_m cross_phase_rad",
    },
    "samples": {"experimental": "probability confidence", "simulation": "seed"},
    "recoverable_sets": {"recoverable": "kind"},
    "goal": {
        "goal": "kind tolerance_m velocity_tolerance_m_s inner_semi_minor_m outer_semi_minor_m"
        " sides cross_track_max_m amplitude_max_m along_track_m state center half_widths"
    },
    "schedule": {"schedule": "min_dwell_steps max_switches delta_v_max_m_s"},
    "upkeep": {"tank": "delta_v_m_s"},
    "passive": {"abort": "drift_orbits drift_s required keep_in"},
    "powered_abort": {
        "abort": "within_s delta_v_max_m_s",
        "abort.orbit": "kind tolerance_m velocity_tolerance_m_s inner_semi_minor_m outer_semi_minor_m"
        " sides cross_track_max_m amplitude_max_m along_track_m state",
    },
    "summary": {"": "title"},
}
"""By claim the keys that are compared with the run under it, or that it is derived from."""

UNCHECKED = {
    "clearance and thrust of the plan beyond the tightening by errors": {
        "planner": "extra_margin_m thrust_reserve",
        "tracking": "thrust_share",
    },
    "optimality of the plan": {"planner": "objective gap"},
    "optimality of the schedule": {
        "schedule": "strategy delta_v_price switch_price",
        "experimental": "weight",
    },
    "that the disturbance bound covers the model error (polaris model-error)": {
        "orbit": "inclination_max_deg radius_deviation_max_m radial_rate_max_m_s rate_deviation_max"
        " density_kg_m3 scale_height_m ballistic_coefficient_m2_kg ballistic_difference_max_m2_kg"
        " other_acceleration_max_m_s2 eccentricity_max"
    },
    "number of simulated runs": {"simulation": "runs"},
    "that the black box was sampled with memory": {"experimental": "memory"},
}
"""Demands of a scenario that are not checked, each with its keys."""

NO_DEMAND = {
    "": "description",
    "obstacles": "unbounded",
    "orbit.elements": "epoch semi_major_axis_m eccentricity inclination_deg ascending_node_deg perigee_deg"
    " true_anomaly_deg frame time_system",
    "planner": "solver max_linear_programs max_nodes time_limit_s",
    "recoverable": "recourse",
    "schedule": "beam bound_programs",
    "tracking": "bound weight",
}
"""Words for readers, where the target is in inertial axes, how plan and schedule are looked for, and the norm
of the balls."""


def listed(tables: Mapping[str, str]) -> list[str]:
    """Return the paths of keys that are listed by table."""
    return [f"{table}.{key}".lstrip(".") for table, keys in tables.items() for key in keys.split()]


def given_keys(table: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """Yield the paths of the keys that a scenario gives; those of lists of tables may come more than once."""
    for key, value in table.items():
        for each in value if isinstance(value, list) else [value]:
            if isinstance(each, dict):
                yield from given_keys(each, f"{prefix}{key}.")
        yield prefix + key


def unchecked_demands(scenario: Mapping[str, Any]) -> list[str]:
    """Return the demands of a scenario that no check confirms, one line for each group of keys."""
    paths, lines = set(given_keys(scenario)), []
    for demand, tables in UNCHECKED.items():
        keys = [key for key in listed(tables) if key in paths]
        names = keys if len(keys) <= 4 else [f"[{table}]" for table in tables]
        lines += [f"{demand}: {', '.join(names)}"] if keys else []
    return lines
