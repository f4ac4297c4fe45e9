"""Each error of the flight hardware alone, up to ten times the size that missions ask for; and all at once.

    python -m benchmarks.tenfold                          print the table of docs/error-costs.md (hours)
    python -m benchmarks.tenfold --write                  and put it into the page
    python -m benchmarks.tenfold static --only mass --times 10
    python -m benchmarks.tenfold --together               the other table: all errors, then faults and aborts

For each scene, error and size a run folder is written under `--out`. At the largest size, and of all errors
at once, its certificate is checked, and a search for runs that break a claim flies `--attacks` trajectories.
What has been found is kept in `tenfold.json` there: a command that was stopped goes on where it was.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from docs.generate.method_docs import PAGE, put
from polaris.certificate.checker import verify
from polaris.model.errors import NotCertified, SynthesisInfeasible
from polaris.runs.schedule import fly_schedule, write_run
from polaris.runs.stages import Stages
from polaris.scenario.scenario import load_scenario
from polaris.simulation.falsification.search import falsify

SCENES = ("static", "dynamic", "keep_out", "hold_point")
TIMES = (1.0, 2.0, 5.0, 10.0)
NAME, COSTS = "tenfold", PAGE.with_name("error-costs.md")

ERRORS: dict[str, tuple[dict[str, float], tuple[str, ...]]] = {
    "navigation": ({"navigation.position_error_m": 0.05, "navigation.velocity_error_m_s": 0.002}, ()),
    "delay": ({"timing.delay_s": 2.0}, ()),
    "bit, carried": ({"thrusters.impulse_bit_N_s": 0.005}, ("thrusters.remainder=carried",)),
    "bit, dropped": ({"thrusters.impulse_bit_N_s": 0.005}, ()),
    "magnitude": ({"thrusters.magnitude_error": 0.05}, ()),
    "misalignment": ({"thrusters.misalignment_deg": 2.0}, ()),
    "mass": ({"thrusters.mass_error": 0.03}, ()),
}
"""Once the size of each error, and what is set besides."""
MOST = {"thrusters.magnitude_error": 0.49}
"""Largest sizes that are not refused: errors of the magnitude stay below a half."""
TOGETHER: dict[str, tuple[str, ...]] = {"none": ()}
"""Overrides declared at once, in steps: errors, then faults and what is asked after them."""
TOGETHER["all"] = (
    *(f"{key}={size:g}" for sizes, _ in ERRORS.values() for key, size in sizes.items()),
    *("thrusters.pulse=centred", "thrusters.remainder=carried"),
)
TOGETHER["all, faults, aborts"] = (
    *TOGETHER["all"],
    'faults=[{kind="loss",share=0.1,isolation_s=4},{kind="navigation_lost",lasts_s=10}]',
    *("abort.drift_orbits=2", "abort.orbit.kind=goal", "tank.delta_v_m_s=20"),
)
CHEAP = ("schedule.bound_programs=0", "simulation.runs=20")
"""Without a bound on other schedules, and with few of the runs that only illustrate."""

Found = dict[str, Any]  # of one scene, error and size; strict JSON


def settings(error: str, times: float) -> list[str]:
    """Return the overrides of a scene with one error `times` its size."""
    sizes, besides = ERRORS[error]
    scaled = [f"{key}={min(size * times, MOST.get(key, size * times)):g}" for key, size in sizes.items()]
    return [*scaled, *besides, *CHEAP]


def judged(scene: str, overrides: Sequence[str], attacks: int | None, folder: Path) -> Found:
    """Return results of a run, of the checker unless `attacks` is None, of attacks; or why there is none."""
    scenario = load_scenario(scene, overrides)
    try:
        outcome = fly_schedule(scenario, Stages())
    except (SynthesisInfeasible, NotCertified) as none:
        return {"reason": str(none), "exit_code": none.exit_code}
    results = said(write_run(folder, scenario, outcome.schedule, outcome.flown).summary, scenario.step)
    results |= {} if attacks is None else {"outcome": verify(folder).outcome}
    return results | ({"attacks": falsify(outcome.schedule, attacks).summary()} if attacks else {})


def said(summary: Mapping[str, Any], delta: float) -> Found:
    """Return the values of a run's summary that the tables have; steps are of `delta` [s]."""
    claim = summary["guarantee"]
    results: Found = {"share": summary["synthesis"]["experimental_share"]}
    results |= {"delta_v_m_s": summary["polaris"]["delta_v_m_s"], "goal": claim["goal"]["reached"]}
    results["collided"] = summary["polaris"]["collided"]
    drift, aborts = (claim.get(name) for name in ("abort", "powered_abort"))
    if drift and aborts:
        steps, witness = aborts["steps"], drift["witness"]
        clear = sum(round((end - start) / delta) for start, end in drift["clear_s"])
        results |= {"drift": f"{clear} of {len(steps)}", "proven_m_s": claim["goal"]["delta_v_max_m_s"]}
        if witness:
            encounter = f"{witness['unsafe_set']} {witness['after_s']:.0f} s later"
            results["drift"] += f" (from {witness['t_s']:g} s: {encounter})"
        results["aborts"] = f"{sum(step['why'] is None for step in steps)} of {len(steps)}"
        results["lasts_h"] = claim["upkeep"] and claim["upkeep"]["lasts_s"] / 3600
    return results


def cell(results: Found) -> str:
    """Return the share of U, and what is not as it should be."""
    if "reason" in results:
        return f"none ({results['exit_code']})"
    problems = [] if results.get("outcome", "VERIFIED") == "VERIFIED" else [results["outcome"]]
    problems += [] if results["goal"] is True else ["goal not proven"]
    problems += ["VIOLATED"] if results.get("attacks", {}).get("violated") else []
    return ", ".join([f"{100 * results['share']:.1f}", *problems])


def table(results: Mapping[str, Found], size: float) -> str:
    """Return a row for each error at a size, with the share of U and the velocity change in each scene."""
    lines = [f"| Error | {' | '.join(f'`{scene}`' for scene in SCENES)} |", "|---" * (len(SCENES) + 1) + "|"]
    for error in ERRORS:
        each = [results.get(f"{scene}, {error}, {size:g}") for scene in SCENES]
        cells = (f"{cell(one)}{_spent(one)}" if one else "-" for one in each)
        lines.append(f"| {error} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _spent(results: Found) -> str:
    return f" ({results['delta_v_m_s']:.2f})" if "delta_v_m_s" in results else ""


def together(results: Mapping[str, Found], scenes: Sequence[str]) -> str:
    """Return a row for each scene and what is declared at once, as far as it is known."""
    head = "Scene", "Declared", "U, %", "m/s", "drift of two orbits clear, steps", "powered abort, steps"
    lines = [f"| {' | '.join((*head, 'tank lasts, h', 'checker'))} |", "|---" * (len(head) + 2) + "|"]
    for scene in scenes:
        for kind in TOGETHER:
            if one := results.get(f"{scene}, {kind}"):
                lasts, delta_v = (one.get(key) for key in ("lasts_h", "delta_v_m_s"))
                cells = [f"{delta_v:.2f}" if delta_v else "-", one.get("drift", "-"), one.get("aborts", "-")]
                cells += [f"{lasts:.1f}" if lasts else "-", one.get("outcome", "-")]
                lines.append(f"| {' | '.join([f'`{scene}`', kind, cell(one), *cells])} |")
    return "\n".join(lines)


def renew(page: str, place: str, text: str) -> str:
    """Return the page with new rows in a table; those of other scenes stay if its columns are the same."""
    head, line, *new = text.splitlines()
    old = page.split(f"<!-- table {place} -->\n\n")[1].split("\n\n<!-- end -->")[0].splitlines()
    rows = {tuple(row.split("|")[1:3]): row for row in [*(old[2:] if old[0] == head else ()), *new]}
    return put(page, place, "\n".join([head, line, *rows.values()]))


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=SCENES, metavar="SCENE")
    parser.add_argument("--only", choices=ERRORS, action="append", help="errors, by default all")
    parser.add_argument("--times", type=float, nargs="+", default=TIMES, help="sizes, in ascending order")
    parser.add_argument("--attacks", type=int, default=2000, help="trajectories at the largest size")
    parser.add_argument("--out", type=Path, default=Path("runs/tenfold"))
    parser.add_argument("--kept", action="store_true", help="tell what has been found, and compute nothing")
    parser.add_argument("--together", action="store_true", help="all errors at once, not each alone")
    parser.add_argument("--write", action="store_true", help="put the rows into the page")
    args = parser.parse_args(arguments)
    args.out.mkdir(parents=True, exist_ok=True)
    store, errors = args.out / "tenfold.json", args.only or list(ERRORS)
    stored: dict[str, Found] = json.loads(store.read_text()) if store.is_file() else {}
    jobs = [
        (f"{scene}, {error}, {size:g}", scene, settings(error, size), size == args.times[-1])
        for size in reversed(args.times)
        for scene in args.scenes
        for error in errors
    ]
    if args.together:
        jobs = [
            (f"{scene}, {kind}", scene, [*TOGETHER[kind], CHEAP[0]], True)
            for scene in args.scenes
            for kind in TOGETHER
        ]
    for name, scene, sets, attacked in () if args.kept else jobs:
        attacks = args.attacks if attacked else None
        if name not in stored or (attacks or 0) > stored[name].get("attacks", {"runs": attacks or 0})["runs"]:
            stored[name] = judged(scene, sets, attacks, args.out / name.replace(", ", "-").replace(" ", "-"))
            store.write_text(json.dumps(stored, indent=1))
        print(f"{name}: {cell(stored[name])}", flush=True)
    text = together(stored, args.scenes) if args.together else table(stored, args.times[-1])
    print(f"\n{text}")
    if args.write:
        page = COSTS.read_text(encoding="utf-8")
        page = renew(page, "together", text) if args.together else put(page, NAME, text)
        COSTS.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
