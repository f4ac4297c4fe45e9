"""The other files of the run folder: hashes, and statements of the readable ones on the same numbers."""

import csv
import math
import re
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..kernel.verdict import Record, Rejected
from ..model.onnx_file import check_file
from ..model.plants import plant_of
from .document import Document
from .file_keys import FLOWN
from .file_keys import SUMMARY as SUMMARY_KEYS
from .repeated import check_gains, check_reference, check_schedule, limit_names, same, share, switches
from .scenario_keys import check_keys
from .structure import LARGEST_SCENARIO, conform, contents, every, exists, sha256, strict_json

NEEDED = (
    *("scenario.toml", "schedule.json", "schedule.csv", "reference.csv", "gains.json"),
    *("sets.npz", "tubes.npz", "trajectories.npz"),
)
"""Files that belong to a run; the last three are hashed, not read."""

MOST_DOTS = 50  # most dots in a key of the scenario: reading takes the square of their number; keys need two
TEXTS = re.compile(
    r"#[^\n]*"
    r'|"""(?:[^\\]|\\.)*?"{3,5}|\'\'\'.*?\'{3,5}'
    r'|"(?:[^"\\\n]|\\[^\n])*"|\'[^\'\n]*\'',
    re.DOTALL,
)
"""Comments and quoted texts, whose dots do not count."""
SUMMARY = "summary.json"  # has wall times, so it has no hash; what it claims is compared


def has_artefacts(document: Document, folder: Path) -> bool:
    """Return True if any file of a run folder lies beside the certificate, named in it or not."""
    return any(exists(folder / name) for name in (*NEEDED, SUMMARY, *document.artefacts))


def check_hashes(document: Document, folder: Path, record: Record) -> None:
    """Compare every file that the certificate names with its hash; it must name all that are needed."""
    for name, expected in sorted(document.artefacts.items()):
        if name != Path(name).name or not (folder / name).is_file():
            raise Rejected("artefacts", f"{ascii(name)} is missing")
        actual = sha256(folder / name)
        if actual != expected:
            raise Rejected("artefacts", f"{ascii(name)} has the hash {actual}, not {ascii(expected)}")
    for name in NEEDED:
        if name not in document.artefacts:
            raise Rejected("artefacts", f"no hash of {name}")
    record.holds("artefacts", f"hashes of {len(document.artefacts)} files agree")


def check_networks(document: Document, scenario: dict[str, Any], folder: Path, record: Record) -> None:
    """Check that layers are those of the files that the scenario names, copied into the folder."""
    laws = zip(document.laws[1:], scenario["experimental"], strict=True)
    networks = [(law, Path(spec["path"]).name) for law, spec in laws if law.kind == "neural"]
    for law, name in networks:
        if name not in document.artefacts:
            raise Rejected("artefacts", f"no hash of {ascii(name)}")
        check_file(law, folder / name)
    if networks:
        record.holds("controllers", f"layers of {len(networks)} networks are those of their files")


def read_scenario(folder: Path) -> dict[str, Any]:
    """Return the scenario file, its keys, types and ranges checked."""
    data = contents(folder / "scenario.toml", LARGEST_SCENARIO)
    try:
        text = data.decode("utf-8")
        if max(part.count(".") for part in re.split(r"[=,{[\n]", TEXTS.sub("", text))) > MOST_DOTS:
            raise ValueError(f"a key has more than {MOST_DOTS} dots")
        scenario = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise Rejected("artefacts", f"scenario.toml cannot be read: {error}") from error
    check_keys(scenario)
    return scenario


@dataclass(frozen=True)
class FileClaims:
    """Claims of the other files that the certificate itself does not make."""

    start_margin: float | None = None  # share of the clearance left to the initial set
    margins: list[float] = field(default_factory=list)  # of every step, share of the clearance that it leaves
    least: float | None = None  # least distance [m] of the drift after all thrust stops
    upkeep: dict[str, Any] | None = None  # what S spends for as long as it flies on
    estimate: dict[str, Any] | None = None  # how far an observer's estimates may be off
    tank: float | None = None  # velocity change that there is propellant for, by the scenario
    budget: float | None = None  # velocity change that the schedule may spend, by the scenario
    goal: tuple[dict[str, Any], dict[str, Any]] | None = None  # what is claimed of it, and the scenario's own
    orbit: dict[str, Any] | None = None  # that an abort with thrust leads to, by the scenario
    aborts: list[float | None] = field(default_factory=list)  # velocity change of an abort in every step
    joint: Any = None  # to the next leg of a mission


def check_artefacts(document: Document, folder: Path, scenario: dict[str, Any], record: Record) -> FileClaims:
    """Compare the certificate with the files that can be read; return the claims left to confirm.

    A file that says something else is `Rejected` under the claim that it is about, one that cannot be read
    under ``artefacts``.
    """
    start = None
    try:
        claimed, margins = check_schedule(document, scenario, folder)
        check_reference(document, folder / "reference.csv")
        check_gains(document, folder / "gains.json")
        record.holds("schedule", "modes, margins, reference and gains agree with the other files")
        if exists(folder / SUMMARY):
            summary = check_summary(document, scenario, claimed, folder / SUMMARY)
            start = summary["synthesis"]["start_margin"]
            record.holds("summary", "claims no more than the certificate")
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, csv.Error) as error:
        raise Rejected("artefacts", f"cannot be read: {type(error).__name__}: {error}") from error
    orbit = scenario.get("abort", {}).get("orbit")
    aborts = claimed.get("powered_abort") or {"steps": []}
    return FileClaims(
        start,
        margins,
        least=claimed.get("abort", {}).get("least_m"),
        upkeep=claimed["upkeep"],
        estimate=claimed.get("estimate"),
        tank=scenario.get("tank", {}).get("delta_v_m_s"),
        budget=scenario.get("schedule", {}).get("delta_v_max_m_s"),
        goal=(claimed["goal"], scenario["goal"]),
        orbit=scenario["goal"] if orbit == {"kind": "goal"} else orbit,
        aborts=[step["delta_v_m_s"] for step in aborts["steps"]],
    )


def unchecked(document: Document, scenario: dict[str, Any], folder: Path) -> list[str]:
    """Return the further statements of a run folder, which no check confirms."""
    specs = scenario["experimental"]
    plans = ", ".join(item["name"] for item in specs if item.get("reference", {}).get("kind") == "unaware")
    optimality = f"unaware plans of {plans} are fuel-optimal (start, dynamics, limits and goal are checked)"
    statistics = "statistics of simulated runs in summary.json, which prove nothing"
    bound = "the bound on U's share over all schedules in summary.json"
    attacks = "the share proven without black boxes, and attacks on them, in summary.json"
    boxes = any(item["kind"] == "black_box" for item in specs)
    reasons = "reasons in schedule.json for margins, colliding drifts, missing aborts, lost steps"
    lines = [statistics, bound, *[attacks] * boxes] * exists(folder / SUMMARY)
    choices = "choices in certificate.json, which readers of a schedule prove again"
    return [*[optimality] * bool(plans), reasons, *lines, *[choices] * bool(document.choices)]


# -- the summary ------------------------------------------------------------------------------------

ROUNDING = 1e-9  # difference between sums that were added up in another order, relative to them


def check_summary(
    document: Document, scenario: dict[str, Any], claimed: dict[str, Any], path: Path
) -> dict[str, Any]:
    """Compare every claim of the summary with the certificate; returns the summary.

    Statistics of simulated runs cannot be confirmed. They must agree with the schedule, with what is proven
    (no run of S or of the schedule collides, S commands no more thrust than there is) and with one another.
    `claimed` is the guarantee as ``schedule.json`` repeats it.
    """
    laws, K = document.laws, document.steps
    # Those flown: S alone, each experimental controller alone, the schedule.
    labels = {mode: "experimental" if mode == 1 else f"experimental_{mode}" for mode in range(1, len(laws))}
    keys = SUMMARY_KEYS | every(FLOWN, " ".join(labels.values()))
    stored: dict[str, Any] = conform(strict_json(contents(path)), keys, "summary", path.name)
    synthesis = stored["synthesis"]
    schedules = {"polaris": ("polaris", document.modes), "safety": (laws[0].name, [0] * K)}
    schedules |= {key: (laws[mode].name, [mode] * K) for mode, key in labels.items()}
    expected: dict[str, Any] = {
        "scenario": document.scenario,
        "title": scenario["title"],
        "seed": scenario.get("simulation", {}).get("seed", 0),
        "guarantee": claimed,
        "synthesis": {
            "recoverable": document.recoverable,
            "experimental_share": share(document.modes),
            "switches": switches(document.modes),
        },
    }
    for key, (name, modes) in schedules.items():
        runs = stored["polaris"]["runs"]
        expected[key] = {"controller": name, "runs": runs, "switches": switches(modes)}
    same("summary", "summary.json", expected, stored)
    if synthesis["start_limit"] not in limit_names(document):
        raise Rejected("summary", "start_limit is no limit of the scene")
    # How the plan was found is no claim of safety; its velocity change is that of the reference.
    delta_v = math.fsum(abs(x) for u in document.inputs[:K] for x in u) * document.delta / document.mass
    _close("velocity change of the plan", delta_v, synthesis["planner"]["delta_v_m_s"])
    for key, (_, modes) in schedules.items():
        _check_flown(document, key, modes, stored[key])
    delta_v, goal = stored["polaris"]["delta_v_max_m_s"], claimed["goal"]["delta_v_max_m_s"]
    objectives = [0.0, *(spec.get("weight", 1.0) for spec in scenario["experimental"])]
    objective = math.fsum(objectives[mode] for mode in document.modes) / K
    worst, bound = synthesis.get("worst_flight"), synthesis["share_at_most"]
    needed = {
        "share_at_most of no less than experimental_share": _raised(bound) >= share(document.modes),
        "share_at_most of no less than proven_share": _raised(bound) >= synthesis.get("proven_share", 0.0),
        "share_bound.objective of no less than the schedule's": _raised(synthesis["share_bound"]["objective"])
        >= objective,
        "worst_flight where, and only where, black boxes fly": "worst_flight" not in synthesis
        or (worst is None) == (not document.sampled_bound),
        "violated with a failure": worst is None or worst["violated"] == (worst["failure"] is not None),
        "velocity changes of runs within the claim": document.guarantee != "proved"
        or bool(document.transients)
        or delta_v <= _raised(goal),
    }
    _hold(needed | _of_model_error(document, stored.get("model_error"), "orbit" in scenario), "")
    return stored


def _of_model_error(document: Document, claim: dict[str, Any] | None, has_orbit: bool) -> dict[str, bool]:
    """Return the conditions on the model error of a summary; its bound itself is not derived here."""
    if claim is None or document.mean_motion is None:
        return {"model_error where the scenario has an orbit": claim is None and not has_orbit}
    bound, parts = claim["bound_m_s2"], math.fsum(claim["parts_m_s2"].values())
    return {
        "model_error where, and only where, the scenario has an orbit": has_orbit,
        "model_error.declared_m_s2 of the system": claim["declared_m_s2"] == document.w_max,
        "model_error.covered as the two bounds have it": claim["covered"] == (bound <= document.w_max),
        "model_error.bound_m_s2 of no less than its parts": _raised(bound) >= parts,
    }


def _close(quantity: str, derived: float, stored: float, size: float | None = None) -> None:
    """Check that numbers are equal up to rounding, relative to a size, or to the derived value itself."""
    difference = abs(derived - stored)
    if not difference <= ROUNDING * (abs(derived) + 1e-300 if size is None else size):
        raise Rejected("summary", f"{quantity}: {stored} in summary.json, derived {derived}", difference)


def _check_flown(document: Document, key: str, modes: list[int], stored: dict[str, Any]) -> None:
    """Check the statistics of runs under known modes."""
    T, allowance = document.steps * document.delta, 1 + ROUNDING
    plant, periods = plant_of(document), document.steps * document.q
    horizon = T if document.mean_motion is None else 2 * math.pi / document.mean_motion
    _close(f"experimental share of {key}", share(modes), stored["experimental_share"], 1.0)
    _close(f"horizon of free drift of {key}", horizon, stored["drift_horizon_s"])
    collisions, collided = stored["collided_runs"], stored["collided"]
    proved = document.guarantee == "proved" and not key.startswith("experimental")
    distances = [stored[name] for name in ("min_distance_m", "min_distance_mean_m", "mean_distance_m")]
    if [x is None for x in distances] != [all(item.of_state for item in document.unsafe)] * 3:
        raise Rejected("summary", f"{key}: distances must be null where no set is in position")
    distances = [math.inf if x is None else x for x in distances]
    (least, mean, all_times), min_ttc = distances, stored["min_ttc_s"]
    drift = stored["min_ttc_free_drift_s"]
    delta_v, delta_v_max = stored["delta_v_m_s"], stored["delta_v_max_m_s"]
    ratios = [stored[f"max_thrust_ratio{suffix}"] for suffix in ("_safety", "_experimental")]
    flies = [any((mode > 0) == experimental for mode in modes) for experimental in (False, True)]
    needed = {
        "collided_runs": collisions <= stored["runs"] and (collisions > 0) == collided,
        "collided, although it is proven not to": not (proved and collided),
        "distances in order": least <= _raised(mean) and mean <= _raised(all_times),
        "min_distance_m, of runs that did not collide": collided or least > 0,
        "min_ttc_s, of runs that did not collide": collided or min_ttc is None or min_ttc > 0,
        "min_ttc_free_drift_s": drift is None or drift <= horizon * allowance,
        "velocity changes in order": delta_v <= delta_v_max * allowance
        and delta_v_max <= delta_v * stored["runs"] * allowance
        and delta_v_max <= float(plant.spending(plant.u_max).upper()) * periods / document.mass * allowance,
        "max_thrust_ratio of who flies": [ratio is not None for ratio in ratios] == flies,
        "max_thrust_ratio": stored["max_thrust_ratio"]
        == max((r for r in ratios if r is not None), default=-1),
        "max_thrust_ratio_safety of at most 1": not proved or ratios[0] is None or ratios[0] <= allowance,
    }
    _hold(needed, f"{key}: ")


def _hold(needed: dict[str, bool], prefix: str) -> None:
    """Refuse a summary in which one number contradicts another."""
    for condition, holds in needed.items():
        if not holds:
            raise Rejected("summary", f"{prefix}{condition} does not hold in summary.json")


def _raised(x: float) -> float:
    """Return a number of any sign moved up by rounding."""
    return x * (1 + math.copysign(ROUNDING, x))
