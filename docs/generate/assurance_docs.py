"""Write ``docs/assurance.md``: each safety requirement, what claims it, what checks it, what tests the check.

Run ``python -m docs.generate.assurance_docs`` after a change. A test compares the page, and asks that every
claim of the checker serves a requirement and that every function and test named here exists.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from polaris.certificate.assumptions import assumptions

PAGE = "assurance.md"


@dataclass(frozen=True)
class Requirement:
    """One safety requirement and what stands behind it.

    Attributes
    ----------
    number : str
    text : str
        What has to hold.
    claims : tuple of str
        Claims of the certificate that say so, by the names of docs/certificate.md.
    established : tuple of str
        Where the synthesis establishes it, ``module:name``.
    tests : tuple of str
        What would fail if it did not hold, ``file::test`` in the folder ``tests``.
    """

    number: str
    text: str
    claims: tuple[str, ...]
    established: tuple[str, ...]
    tests: tuple[str, ...]


REQUIREMENTS = (
    Requirement(
        "R1",
        "The vehicle stays out of every unsafe set, at every instant of [0, T], from every initial state, "
        "whatever the disturbance.",
        ("reference", "separation", "recoverable"),
        ("polaris.synthesis.clearance:facet_room", "polaris.synthesis.synthesize:synthesize"),
        (
            "polaris/test_synthesis.py::test_no_run_breaks_the_claim",
            "polaris/test_certificate.py::test_bundled_scenarios_verify",
            "polaris/test_falsify.py::test_a_million_trajectories_violate_nothing",
        ),
    ),
    Requirement(
        "R2",
        "The safety controller can take over before the experimental one leads to harm.",
        ("recoverable", "recoverable_sets", "margins", "schedule"),
        ("polaris.synthesis.get_safety:get_safety", "polaris.synthesis.polytope_sets:PolytopeSets"),
        (
            "polaris/test_tubes.py::test_a_switch_to_s_between_two_nodes_lands_in_the_hull_of_the_nodes",
            "paper/test_errata_tracking.py::test_item_5_polytopes_are_no_smaller_than_the_balls_anywhere",
            "polaris/test_falsify.py::test_a_schedule_that_ignores_its_proof_collides",
        ),
    ),
    Requirement(
        "R3",
        "The safety controller never asks for more thrust than there is.",
        ("thrust", "recoverable", "error_bounds"),
        ("polaris.synthesis.get_safety:get_safety",),
        (
            "paper/test_errata_tracking.py::test_item_7_reference_inputs_leave_room_for_the_tracker",
            "polaris/test_certificate.py::test_the_printed_ball_is_rejected_because_the_thrusters_saturate",
            "polaris/test_falsify.py::test_printed_ball_without_thrust_limits_is_caught",
        ),
    ),
    Requirement(
        "R4",
        "Whatever the experimental controller does within its declared model is covered.",
        ("controllers", "enclosures", "separation"),
        ("polaris.synthesis.controllers:AffineController", "polaris.synthesis.controllers:AnyThrust"),
        (
            "polaris/test_tubes.py::test_tube_holds_the_flight_at_and_between_nodes",
            "polaris/test_certificate.py::test_anything_within_the_thrust_limits_verifies",
            "polaris/test_falsify.py::test_black_box_does_what_the_attack_says",
        ),
    ),
    Requirement(
        "R5",
        "The unsafe sets that are avoided contain those that were declared, moving ones at every instant.",
        ("unsafe_sets",),
        ("polaris.model.obstacle:Obstacle", "polaris.model.satellite:SatelliteObstacle"),
        (
            "polaris/test_obstacles.py::test_rigid_sets_are_inside_their_polytopes",
            "polaris/test_obstacles.py::test_satellite_is_inside_its_polytope_at_every_instant",
            "polaris/test_satellites.py::test_the_worst_motion_never_leaves_the_polytope_and_touches_it",
        ),
    ),
    Requirement(
        "R6",
        "What holds after T is stated, and no more than is proven.",
        ("end", "goal", "guarantee"),
        ("polaris.synthesis.end_condition:EndCondition",),
        (
            "polaris/test_synthesis.py::test_what_is_proven_after_t",
            "paper/test_errata_tracking.py::test_item_12_a_reference_safe_until_T_may_be_unsafe_right_after_it",
        ),
    ),
    Requirement(
        "R7",
        "The model's error is within the disturbance that the proof allows.",
        ("system",),
        ("polaris.simulation.orbit.model_error:model_error",),
        (
            "polaris/test_model_error.py::test_disturbance_bound_in_the_file_covers_the_model_error",
            "polaris/test_model_error.py::test_schedule_is_safe_in_the_nonlinear_motion",
        ),
    ),
    Requirement(
        "R8",
        "What is flown is what was proven: the same system, initial set, sampling, schedule and gains.",
        (
            "format",
            "digest",
            "artefacts",
            "scenario",
            "summary",
            "system",
            "initial_set",
            "sampling",
            "controllers",
        ),
        ("polaris.runs.certificate:certificate",),
        (
            "polaris/test_corruptions.py::test_the_other_files_give_it_away",
            "polaris/test_corruptions.py::test_blind_edits_are_refused_by_the_digest",
            "polaris/test_runfolder.py::test_gains_hold_what_a_replay_needs",
        ),
    ),
    Requirement(
        "R9",
        "The check does not share the faults of what it checks.",
        (),
        ("polaris.certificate.checker:verify",),
        (
            "polaris/test_certificate.py::test_a_module_of_the_checker_imports_its_own_kind_only",
            "polaris/test_certificate.py::test_the_checker_runs_where_nothing_else_can_be_imported",
            "polaris/test_corruptions.py::test_the_argument_notices",
        ),
    ),
)

MISSION = (
    ("The initial state lies in the initial set at t = 0", "navigation, before the schedule is started"),
    (
        "The disturbance stays within its bound",
        "model error (R7), thruster and attitude errors, by analysis or test",
    ),
    (
        "The unsafe sets are where the scenario puts them",
        "perception, with its own error bounds inflated into the sets",
    ),
    (
        "Unsafe sets at rest stay at rest, for as long as safety is claimed",
        "perception, or a schedule made anew in time",
    ),
    (
        "The controlled body is a point",
        "its own size, and that of what it carries, added to every unsafe set",
    ),
    (
        "Other satellites obey the same linear equations, within the same disturbance bound",
        "`thrust_accel_max_m_s2` covers their own thrust and the model's error where they are (R7)",
    ),
    ("Control periods are kept and commands arrive", "timing analysis of the flight computer"),
    (
        "Clocks are exact: schedule, reference and unsafe sets count from one instant",
        "time synchronisation; an error of time is one of position along the motion: inflate sets by it",
    ),
    (
        "There is fuel for every command, for as long as safety is claimed",
        "propellant budget, S's flight after T included",
    ),
    (
        "The state that controllers use is exact",
        "navigation error: inflate sets, or add it to the disturbance",
    ),
    (
        "Thrusters deliver what is asked, up to their limits",
        "propulsion; quantisation belongs to the disturbance",
    ),
    (
        "The switch itself works, and S runs when its turn comes",
        "redundancy and monitoring of the flight software",
    ),
    ("Experimental controllers obey their declared models", "the output limiter ahead of the thrusters"),
)
"""What a proof about a model cannot say, and who has to."""


def page_text() -> str:
    """The page, in Markdown."""
    lines = [
        "# Assurance: from requirements to tests",
        "",
        "Generated by `python -m docs.generate.assurance_docs`. This page follows the run-time assurance",
        "practice of ASTM F3269: a trusted controller (S), a switch whose logic is fixed before the flight",
        "(the schedule), an untrusted controller (U), and a trace from every safety requirement to evidence.",
        "",
        "*Claims* are those of the [certificate](certificate.md), re-derived by `polaris verify`;",
        "*established by* is where the synthesis does it; *tests* would fail if it did not hold.",
        "",
        "| | Requirement | Claims | Established by | Tests |",
        "|---|---|---|---|---|",
    ]
    for item in REQUIREMENTS:
        cells = (
            item.number,
            item.text,
            ", ".join(f"`{claim}`" for claim in item.claims) or "all",
            ", ".join(f"`{name.replace(':', '.')}`" for name in item.established),
            "<br>".join(f"`{test.split('::')[1]}`" for test in item.tests),
        )
        lines.append("| " + " | ".join(cells) + " |")
    lines += [
        "",
        "## What the certificate rests on",
        "",
        "Every certificate, and every run, carries those of these assumptions that apply, in words (here for "
        "1e-5 m/s², a period of 2 s and a claim up to 3600 s):",
        "",
        *(
            f"- {text}"
            for text in assumptions(1e-5, 2.0, satellites=True, horizon="one_period", until=3600.0)
        ),
        "",
        "## What a mission must discharge itself",
        "",
        "A proof about a model says nothing about whether the model is the world. Left to the mission:",
        "",
        "| Assumption | Where it is discharged |",
        "|---|---|",
        *(f"| {text} | {where} |" for text, where in MISSION),
        "",
    ]
    return "\n".join(lines)


def write(folder: Path) -> Path:
    """Write the page into a folder; return its path."""
    path = folder / PAGE
    path.write_text(page_text(), encoding="utf-8", newline="\n")
    return path


if __name__ == "__main__":
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parents[1]
    print(write(target))
