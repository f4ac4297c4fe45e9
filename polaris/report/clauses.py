"""Clauses that a mission near another spacecraft answers, each with the files of a run that answer it.

``docs/assurance.md`` has the clauses, and the dossier puts the values of one run beside them.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Evidence:
    """A value of a run: words for it, and its address as ``file: key.key``; lists are walked.

    Addresses ``claim: Head`` are sentences of the guarantee in ``summary.json``: of a claim, not of a flight.
    """

    words: str
    address: str


@dataclass(frozen=True)
class Clause:
    """A clause: its source and title, evidence for it, and the part that only the mission can do.

    `asks` says in English what a public text asks for, and is empty where clauses are named by title only.
    """

    source: str
    title: str
    evidence: tuple[Evidence, ...]
    mission: str
    asks: str = ""


FRENCH, ISO, ESA = "French technical regulation", "ISO 24330:2022", "ESA guidelines"
SOURCES = {
    FRENCH: "Arrêté of 31 March 2011 as changed on 28 June 2024, third part, chapter V, in-orbit service;"
    " what an article asks is said in our words.",
    ISO: "Programmatic principles and practices for rendezvous, proximity operations and on-orbit servicing;"
    " clauses by number and title, their text is not quoted.",
    ESA: "Guidelines for Safe and Sustainable Close-Proximity Operations, October 2021; by topic, without"
    " their text.",
}
"""Texts that the clauses are from, and what is said of them."""

SAFE = Evidence("proven safe", "claim: Safe")
GOAL = Evidence("goal", "claim: Goal")
UPKEEP = Evidence("station-keeping delta-v", "claim: Upkeep")
PASSIVE = Evidence("all thrust off", "claim: Passive safety")
POWERED = Evidence("abort with thrust", "claim: Powered abort")
CHECK = Evidence("independent check", "check: outcome")
LEAST = Evidence("minimum distance in simulated runs", "summary.json: polaris.min_distance_m")
ENTER = Evidence("simulated runs that enter a keep-out zone", "summary.json: polaris.collided_runs")
SHARE = Evidence("share of the time under untrusted control", "summary.json: synthesis.experimental_share")
RUNS = Evidence("simulated runs", "summary.json: polaris.runs")
DRIFT = Evidence(
    "minimum time to collision with thrusters off, in simulated runs",
    "summary.json: polaris.min_ttc_free_drift_s",
)
SETS = Evidence("keep-out zones", "scenario.toml: obstacles.name")
ZONES = "keep_in, navigation.within_m and phases"
CORRIDORS = Evidence("keep-in zones", f"scenario.toml: {ZONES}")
THRUST = Evidence("peak thrust demand of S", "summary.json: polaris.max_thrust_ratio_safety")
SHARE = Evidence("share of the time under untrusted control", "summary.json: synthesis.experimental_share")
START = Evidence("start margin", "summary.json: synthesis.start_margin")
BOX = Evidence("box around the start set", "scenario.toml: initial_set")
JOINTS = Evidence("GO boxes between legs", "summary.json: mission.joints")
WHOLE = Evidence("delta-v of all legs, at most", "summary.json: mission.delta_v_max_m_s")
ALLOWED = Evidence("disturbance that the proof allows", "scenario.toml: system.disturbance_max_m_s2")
MODEL = Evidence("bound on the model error, not verified", "summary.json: model_error.bound_m_s2")
ERRORS = (
    Evidence("errors of navigation", "scenario.toml: navigation"),
    Evidence("errors of thrusters", "scenario.toml: thrusters"),
    Evidence("timing", "scenario.toml: timing"),
)
FAULTS = Evidence("declared faults", "scenario.toml: faults.kind")
DIGESTS = Evidence("SHA-256 of certificate.json, which has those of all files", "check: digest")

CLAUSES = (
    Clause(
        FRENCH,
        "Art. 47-2, survival mode and collision",
        (SAFE, PASSIVE, POWERED, DRIFT),
        "that survival mode is S, or all thrust off; attitude and power in it",
        "Entering survival mode brings no risk of a collision with the target.",
    ),
    Clause(
        FRENCH,
        "Art. 47-5, volumes and corridors",
        (SETS, CORRIDORS, SAFE, LEAST, THRUST),
        "the volumes themselves; the monitor's software and computer; a target that is not as declared",
        "Volumes and corridors of approach are defined; leaving one is monitored all the time, and a fallback"
        " keeps both objects safe.",
    ),
    Clause(
        FRENCH,
        "Art. 47-6, GO and NO-GO",
        (JOINTS, BOX, START, GOAL, UPKEEP),
        "attitude and rates; states of equipment and ground; who decides",
        "At hold or passage points the states of both objects that allow to go on are defined in advance:"
        " position, velocity, attitude, rates.",
    ),
    Clause(
        FRENCH,
        "Art. 47-16, performance in the approach",
        (SAFE, ENTER, RUNS, ALLOWED, MODEL),
        "the probability that an assumption does not hold, which is all that is left of it",
        "Corridors are violated with a probability of less than 1 % per approach.",
    ),
    Clause(
        ISO,
        "4.1.1 Promote safety and mission success",
        (SAFE, GOAL),
        "hazard analysis, everything but relative motion",
    ),
    Clause(
        ISO,
        "5.1.3 Resilient software design and verification",
        (CHECK, SHARE),
        "flight software of S, switch and monitor",
    ),
    Clause(
        ISO,
        "5.1.4 Concepts of operation, 5.1.5 Approved and proven procedures",
        (DIGESTS,),
        "approval; commands from the ground",
    ),
    Clause(ISO, "5.2.3 Trajectory practice", (LEAST, GOAL, UPKEEP, WHOLE), "choice of the goal and of zones"),
    Clause(
        ISO,
        "5.2.5 Collision avoidance practices in proximity",
        (SETS, SAFE, THRUST, POWERED),
        "conjunctions with third objects; a client that is not as declared",
    ),
    Clause(
        ISO,
        "5.2.6 Anomaly resolution",
        (FAULTS, Evidence("isolated late", "claim: Isolated late")),
        "failures of S's sensors and computer, and those not declared",
    ),
    Clause(ISO, "5.2.7 On-orbit checkout", ERRORS, "the checkout that shows these bounds"),
    Clause(
        ISO,
        "5.3.2 Avoiding physical interference",
        (Evidence("radius of the chaser", "scenario.toml: chaser.radius_m"), SETS, LEAST),
        "plumes, contact, debris",
    ),
    Clause(ISO, "4.2 and 5.4 Transparency, sharing of information", (CHECK, DIGESTS), "notification"),
    Clause(ESA, "Keep-out zones and approach corridors", (SETS, CORRIDORS, SAFE), "their sizes"),
    Clause(
        ESA,
        "Passive safety of trajectories",
        (PASSIVE, DRIFT),
        "what to do at steps that are not clear; drifts of flights under the monitor",
    ),
    Clause(
        ESA,
        "Active safety: abort and collision avoidance",
        (SAFE, THRUST, POWERED),
        "what to do at steps from which it is not proven; aborts of flights under the monitor",
    ),
    Clause(ESA, "Go/no-go criteria", (JOINTS, BOX, START), "criteria of other subsystems"),
    Clause(
        ESA,
        "Navigation and actuation performance",
        (*ERRORS, Evidence("estimates", "claim: Estimate")),
        "error budgets that justify the numbers",
    ),
    Clause(
        ESA,
        "Failure tolerance",
        (FAULTS, SAFE),
        "that isolation is as fast as declared; a second fault; S itself",
    ),
    Clause(ESA, "Verification and validation", (CHECK, ALLOWED, MODEL, RUNS, ENTER), "hardware in the loop"),
)
