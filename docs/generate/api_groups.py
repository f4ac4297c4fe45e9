"""What the pages of the Python interfaces hold: introductions, and public names in groups."""

from __future__ import annotations

GROUPS = {
    "The two algorithms": ("get_safety", "synthesize", "SwitchingRules"),
    "What goes in": (
        "Problem",
        "LinearSystem",
        "clohessy_wiltshire",
        "Zonotope",
        "PlannerOptions",
        "Progress",
    ),
    "Unsafe sets": (
        "BoxObstacle",
        "BallObstacle",
        "PolytopeObstacle",
        "SatelliteObstacle",
        "KeepInPolytope",
        "KeepInCone",
        "Obstacle",
        "TimedPolytope",
    ),
    "Goals": ("EllipticalNMT", "LinearNMT", "StationaryPoint", "Box", "Goal"),
    "Controllers": ("AffineController", "AnyThrust", "Controller", "TubeSegment"),
    "What comes out": (
        "Safety",
        "Schedule",
        "Step",
        "Margin",
        "EndCondition",
        "Reference",
        "Plan",
        "Stage",
        "RecoverableSet",
        "Clearance",
        "Tracking",
        "Feedback",
        "ErrorBounds",
    ),
    "Simulation": ("simulate", "Runs", "evaluate", "Metrics", "compare", "Flown", "Flights"),
    "Attacks, and the nonlinear motion": (
        "falsify",
        "Falsification",
        "Failure",
        "write_case",
        "replay",
        "model_error",
        "ModelError",
        "Environment",
        "fly_true",
        "TrueFlights",
    ),
    "Run-time assurance compared": (
        "compare_methods",
        "Comparison",
        "Outcome",
        "write_comparison",
        "read_comparison",
        "ComparisonFolder",
        "Scene",
        "Method",
        "Seen",
        "Choice",
        "Claim",
    ),
    "The online monitor": (
        "FlightLoop",
        "Command",
        "OnlineMonitor",
        "Answer",
        "Monitor",
        "Measurement",
        "RuntimeOptions",
        "DecisionLog",
        "read_log",
        "replay_log",
    ),
    "Campaigns, traces, reports": (
        "run_campaign",
        "CampaignPlan",
        "make_cases",
        "read_campaign",
        "CampaignFolder",
        "read_trace",
        "write_trace",
        "evaluate_trace",
        "TraceMetrics",
        "write_report",
    ),
    "Scenario files": ("load_scenario", "bundled_scenarios", "Scenario"),
    "Run folders and figures": ("write_run", "read_run", "RunFolder", "plot_reference", "plot_schedule"),
    "Hill's frame": ("free_flight", "elliptical_nmt"),
    "Errors": (
        "PolarisError",
        "ScenarioError",
        "SynthesisInfeasible",
        "NotCertified",
        "OutOfTime",
        "ClockWarning",
    ),
}
"""Every public name of `polaris` but ``__version__``, in the order of the page."""

REACH_GROUPS = {
    "Systems": ("LinearSystem", "Signal", "LTVSystem", "Varying"),
    "Tubes": (
        "support_tube",
        "SupportTube",
        "zonotope_tube",
        "ZonotopeTube",
        "ltv_support_tube",
        "ltv_zonotope_tube",
    ),
    "Verification": ("verify", "Always", "Never", "Verdict", "Trajectory", "simulate", "worst_case"),
    "Sets": (
        "Interval",
        "Zonotope",
        "HPolytope",
        "Ellipsoid",
        "AffineImage",
        "MinkowskiSum",
        "Intersection",
        "ConvexSet",
    ),
    "Questions about sets": ("contains", "disjoint", "Answer", "largest_norm", "NormBracket"),
    "Enclosures": (
        "reduce",
        "reduction_loss",
        "enclosing_hull",
        "meet_halfspace",
        "ball_generators",
        "clip_relaxation",
        "outline",
    ),
    "Switched systems": (
        "HybridAutomaton",
        "Mode",
        "Transition",
        "hybrid_tube",
        "HybridTube",
        "Segment",
        "Fan",
        "verify_hybrid",
        "HybridVerdict",
        "falsify_hybrid",
        "simulate_hybrid",
        "replay_hybrid",
        "HybridTrajectory",
        "Visit",
    ),
    "Closed loops and exponentials": ("LinearFlow", "state_scale", "discretize", "growth", "powers"),
    "Errors": ("ReachError", "Unresolved", "ReachWarning"),
}
"""Every public name of `reach`, in the order of the page."""

ASIF_GROUPS = {
    "The problem": ("Inspection", "Strengthening", "SampledData", "Families", "Rows", "allowable"),
    "Filters": (
        "ActiveSetFilter",
        "ImplicitASIF",
        "ExplicitSimplex",
        "ImplicitSimplex",
        "Decision",
        "RunTimeFilter",
        "Centralized",
        "Decentralized",
        "Filtered",
    ),
    "Backup controllers": ("Backup", "Coast", "Parking", "Tracker", "Outlook"),
    "Fuel limit": ("FuelLimit", "fly_fuel_limit", "FuelRun"),
    "Flights": ("fly", "fly_one", "InspectionRun", "NoInput", "LQR", "Phases"),
    "Monte Carlo": ("initial_conditions", "fly_block", "Study", "Outcome"),
}
"""Every public name of `polaris.inspection`, in the order of the page."""

INTRODUCTION = """\
# Python interface

<!-- Generated from the docstrings by `python -m docs.generate.api_docs`. Do not edit. -->

Everything below is imported from `polaris`, as in `polaris.get_safety(...)`; `polaris.__version__` is the
version. Results are frozen dataclasses. Quantities are in SI units (m, m/s, s, kg, N, rad/s); states in
Hill's frame are `[r_x, r_y, r_z, v_x, v_y, v_z]` with x radial, y along-track and z cross-track. Symbols are
those of [theory](theory.md).
"""

REACH_INTRODUCTION = """\
# Interface of `reach`

<!-- Generated from the docstrings by `python -m docs.generate.api_docs`. Do not edit. -->

Everything below is imported from `reach`, as in `reach.verify(...)`. Units are yours: whatever the matrices
are in. Sets and results are frozen dataclasses; leading axes of a set's arrays are a stack of sets.
"""


ASIF_INTRODUCTION = """\
# Interface of `polaris.inspection`

<!-- Generated from the docstrings by `python -m docs.generate.api_docs`. Do not edit. -->

Everything below is imported from `polaris.inspection`, as in `polaris.inspection.ActiveSetFilter(...)`.
Quantities are in SI units; states in Hill's frame are `[x, y, z, vx, vy, vz]`: x radial, y along-track,
z cross-track, and the chief at the origin. Symbols are those of the inspection paper and of
[its theory](inspection-theory.md).
"""
