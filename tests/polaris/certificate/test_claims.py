"""Claims of a run beside safety, against what its scenario demands and the rest of its folder."""

import json
import tomllib

import numpy as np
import pytest

from polaris.certificate.checker import verify
from polaris.certificate.files.demands import CHECKED, NO_DEMAND, UNCHECKED, listed
from polaris.certificate.files.scenario_keys import SCENARIO
from polaris.certificate.files.structure import Items, OneOf
from polaris.model.errors import ScenarioError
from polaris.runs.read_schedule import read_schedule
from polaris.runs.run import run
from polaris.scenario.reading import write_toml
from polaris.scenario.scenario import load_scenario
from polaris.scenario.tables.methods import ScheduleTable
from polaris.simulation.simulate import simulate
from polaris.synthesis.schedule.synthesize import synthesize
from tests.polaris.certificate.test_forged_runs import NO_CLAIM
from tests.polaris.forging import QUARTER, Forger, Lie, make, pattern, places, replaced
from tests.polaris.tiny import TINY

CART = {
    "system": {
        "kind": "linear",
        "A": [
            [0.0, 1.0, 0.0],
            [0.0, -4.0, 0.0],
            [1.0, 0.0, 0.0],
        ],  # velocity, force of a slow motor, position
        **{"B": [[0.0], [4.0], [0.0]], "D": [[1.0], [0.0], [0.0]], "input_max": 1.0},
        **{"disturbance_max": 0.01, "position_states": [2]},
    },
    "initial_set": {"kind": "box", "center": [0.0, 0.0, 0.0], "half_widths": [0.01, 0.01, 0.02]},
    "tracking": {"Q": [1.0, 1.0, 1.0], "R": [1.0]},
    "goal": {"kind": "box", "center": [0.0, 0.0, 3.0], "half_widths": [0.02, 0.5, 0.01]},
    "obstacles": [
        {"kind": "polytope", "name": "wall", "normals": [[-1.0]], "offsets_m": [-4.0], "unbounded": True}
    ],
    "experimental": [{"kind": "saturated_affine", "name": "u", "Q": [1.0, 1.0, 2.0], "R": [1.0]}],
}
"""An odd number of states, in an order of their own, one of which is neither position nor velocity."""


def test_velocities_are_those_of_the_position_wherever_they_stand(tmp_path):
    """To the synthesis, to the checker and in flight."""
    base = tomllib.loads(TINY.read_text(encoding="utf-8")) | CART
    base |= {"feedback": {"period_s": 0.25}, "simulation": {"runs": 2}, "schedule": {"bound_programs": 0}}
    (tmp_path / "cart.toml").write_text(write_toml(base), encoding="utf-8")
    folder = run(tmp_path / "cart.toml", tmp_path / "run")
    assert verify(folder.path).outcome == "VERIFIED"
    goal = folder.summary["guarantee"]["goal"]
    assert goal["velocity_time_s"] == 3.0 and goal["drift_m_per_orbit"] is None  # a quarter of 12 s
    states = folder.plot_data().flights["polaris"].states[:, round(goal["by_s"] / 0.25)]
    velocity, _, position = (np.abs(states - [0.0, 0.0, 3.0]) - [0.02, 0.5, 0.01]).T  # beyond the goal's box
    assert np.all(np.maximum(position, 3.0 * velocity) <= goal["distance_m"])


def test_velocities_have_a_tolerance_of_their_own(tmp_path, most=0.5):
    """A goal claimed as reached is within both, to the checker too, which refuses a narrower one."""
    near = ["goal.tolerance_m=2.0", f"goal.velocity_tolerance_m_s={most}", "schedule.bound_programs=0"]
    forger = Forger(make([QUARTER, *near], tmp_path), tmp_path)
    assert forger.judge({}).outcome == "VERIFIED"
    lie = Lie(forger)
    goal = lie.schedule["guarantee"]["goal"]
    assert goal["reached"] is True and goal["velocity_time_s"] == pytest.approx(2.0 / most)
    lie.scenario["goal"]["velocity_tolerance_m_s"] = 0.9 * most
    lie.judge({"goal"})
    lie = Lie(forger)
    for name in ("schedule", "summary"):
        getattr(lie, name)["guarantee"]["goal"]["velocity_time_s"] = 1.0
    lie.judge({"goal"})
    near = [QUARTER, "goal.tolerance_m=0.5", "goal.velocity_tolerance_m_s=0.1"]
    schedule = synthesize(load_scenario(TINY).with_assignments(near))
    runs, arrival = simulate(schedule, 200, 0, disturbance="worst", tail=True), schedule.arrival
    deviation = np.abs(runs.states[:, round(arrival.by / 0.25)] - [8.0, 6.0, 0.0, 0.0]).max(axis=0)
    assert arrival.distance <= 0.5 and np.all(deviation[:2] <= 0.5) and 0.03 < deviation[2:].max() <= 0.1


def test_the_orbit_of_an_abort_has_a_tolerance_of_velocities_too(tmp_path):
    """Aborted flights arrive slowly enough, by the schedule's claim and by the checker's."""
    orbit = '{kind="stationary",state=[0.0,6.0,0.0,0.0],tolerance_m=0.5,velocity_tolerance_m_s=0.05}'
    assignments = [QUARTER, f"abort={{orbit={orbit},within_s=14.0}}", "schedule.bound_programs=0"]
    forger = Forger(make(assignments, tmp_path), tmp_path)
    assert forger.judge({}).outcome == "VERIFIED"
    schedule = read_schedule(forger.run)
    k, way = next((k, way) for k, way in enumerate(schedule.powered.ways) if way.branch is not None)
    runs = simulate(schedule.aborted(k), 40, 0, disturbance="worst", tail=True)
    deviation = np.abs(runs.states[:, way.cell * 4] - [0.0, 6.0, 0.0, 0.0]).max(axis=0)
    assert np.all(deviation <= [0.5, 0.5, 0.05, 0.05])
    lie = Lie(forger)
    lie.scenario["abort"]["orbit"]["velocity_tolerance_m_s"] = 0.001
    lie.judge({"powered_abort"})


MIXED = {
    **{"A": [[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0] * 4, [0.0] * 4]},
    **{"B": [[0.5, 0.0], [0.0, 0.5], [1.0, 0.0], [0.0, 1.0]]},
    **{"C": [[1.0, 0.0, -0.5, 0.0], [0.0, 1.0, 0.0, 0.0]]},
}
"""The robot, one state of which is a position plus half a velocity: that velocity is part of the position."""


def test_a_tolerance_of_velocities_without_effect_is_refused(tmp_path):
    """A run that is far faster would count as reached, to the checker too."""
    base = load_scenario(TINY).with_assignments([QUARTER, "goal.tolerance_m=2.0"]).to_dict()
    base |= {"schedule": {"bound_programs": 0}, "simulation": {"runs": 2}}
    base["system"] |= MIXED
    base["system"].pop("position_states", None)
    file = tmp_path / "scene.toml"
    file.write_text(write_toml(base), encoding="utf-8")
    lie = Lie(Forger(run(file, tmp_path / "run").path, tmp_path))
    lie.scenario["goal"]["velocity_tolerance_m_s"] = 1e-6
    lie.judge({"goal"})
    scenario = load_scenario(file).with_assignments(["goal.velocity_tolerance_m_s=1e-6"])
    with pytest.raises(ScenarioError, match="velocity_tolerance_m_s.*has no velocity among the states"):
        synthesize(scenario)


def paths(shape, at=()):
    """Every key of the checker's table of a scenario file, which is that of the models."""
    match shape:
        case dict():
            for key, item in shape.items():
                yield from paths(item, (*at, key.removesuffix("?")))
        case OneOf(tables):
            yield ".".join((*at, "kind"))
            for table in tables.values():
                yield from paths(table, at)
        case Items(item) if isinstance(item, (dict, OneOf)):
            yield from paths(item, at)
        case _:
            yield ".".join(at)


def test_every_key_of_a_scenario_is_checked_or_told_as_not_checked_or_demands_nothing():
    """A new key? If it demands something, check it and name the claim, or have it printed as not checked."""
    checked = [key for tables in CHECKED.values() for key in listed(tables)]
    every = [*checked, *(key for tables in (*UNCHECKED.values(), NO_DEMAND) for key in listed(tables))]
    assert len(set(every)) == len(every)
    new = set(paths(SCENARIO)) - set(every)
    assert not new, f"enter into polaris/certificate/files/demands.py: {sorted(new)}"
    assert set(every) == set(paths(SCENARIO))
    rules = (rule.removeprefix("scenario.toml: ").removesuffix(" *") for rule in NO_CLAIM)
    assert {rule.replace(".*.", ".") for rule in rules} & set(checked) == {"title", "goal.sides"}


DEMANDING = (
    *(QUARTER, "schedule.min_dwell_steps=2", "schedule.max_switches=5", "schedule.delta_v_max_m_s=8.0"),
    *("schedule.bound_programs=0", "goal.tolerance_m=0.5", "goal.velocity_tolerance_m_s=0.2"),
    *("tank.delta_v_m_s=1000.0", "planner.thrust_reserve=0.2", "planner.gap=0.001"),
    'abort={drift_s=5.5,orbit={kind="goal"},within_s=30.0,delta_v_max_m_s=20.0}',
)
TIGHTER = {
    "schedule.delta_v_max_m_s": 0.1,
    "schedule.max_switches": 0,
    "schedule.min_dwell_steps": 12,
    "goal.tolerance_m": 0.01,
    "goal.velocity_tolerance_m_s": 0.001,
    "tank.delta_v_m_s": 0.1,
    "abort.drift_s": 60.0,
    "abort.required": True,
    "abort.within_s": 2.0,
    "abort.delta_v_max_m_s": 0.1,
}
"""Of every number that is a demand one that the run does not keep."""


@pytest.fixture(scope="module")
def demanding(tmp_path_factory):
    folder = tmp_path_factory.mktemp("demanding")
    return Forger(make(DEMANDING, folder), folder)


def test_what_is_demanded_and_not_checked_is_printed(demanding):
    """A new limit on a schedule? Enter it into `DEMANDING` and `TIGHTER`."""
    assert {key for claim in ("schedule", "upkeep") for key in listed(CHECKED[claim])} <= set(TIGHTER)
    verdict = demanding.judge({})
    assert verdict.outcome == "VERIFIED", verdict.text()
    lines = [line for line in verdict.text().splitlines() if line.startswith("not checked: ")]
    assert any(line.endswith(": planner.extra_margin_m, planner.thrust_reserve") for line in lines)
    assert "not checked: optimality of the plan: planner.objective, planner.gap" in lines
    assert not any(key in line for line in lines for key in ("orbit", "delta_v_max", "bound_programs"))


@pytest.mark.parametrize("key", TIGHTER)
def test_a_folder_that_does_not_keep_what_its_scenario_demands_is_refused(demanding, key):
    """The scenario says more, its hash and what other files repeat of it are right."""
    lie, (table, name) = Lie(demanding), key.split(".")
    lie.scenario[table][name] = TIGHTER[key]
    if table == "schedule":
        lie.schedule["rules"][ScheduleTable.python_names()[name]] = TIGHTER[key]
    claims = {claim for claim, tables in CHECKED.items() if key in listed(tables)}
    lie.judge(claims | ({"powered_abort"} if table in ("tank", "abort") else set()))


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plain")
    return Forger(make([QUARTER, "schedule.bound_programs=0", "goal.tolerance_m=2.0"], folder), folder)


@pytest.mark.parametrize("asked", [{"required": True}, {"within_s": 2.0}, {"delta_v_max_m_s": 0.1}], ids=str)
def test_limits_of_an_abort_without_an_orbit_are_refused(asked, plain):
    """Nothing is proven of an abort, whatever the table asks of it."""
    lie = Lie(plain)
    lie.scenario["abort"] = asked
    lie.judge({"powered_abort"})


def test_a_tank_of_which_a_run_says_nothing_is_printed_as_not_checked(plain):
    """A run need not say what S spends for ever; then nothing compares it with the tank."""
    lie = Lie(plain)
    lie.scenario["tank"] = {"delta_v_m_s": 1e-3}
    for name in ("schedule", "summary"):
        getattr(lie, name)["guarantee"]["upkeep"] = None
    verdict = lie.verdict()
    assert verdict.outcome == "VERIFIED", verdict.text()
    assert any(line.endswith(": tank.delta_v_m_s") for line in verdict.unchecked)


CONTRARY = {
    "seed": [7],
    "synthesis.experimental_share": [0.9],
    "synthesis.share_at_most": [0.0],
    "synthesis.share_bound.objective": [0.0],
    "synthesis.switches": [9],
    "synthesis.start_margin": [0.99],
    "synthesis.start_limit": ["nothing at all"],
    "synthesis.recoverable": ["ball"],
    "*.controller": ["s"],
    "*.runs": [3],
    "*.min_distance_m": [None, 1e9, 0.0],
    "*.min_distance_mean_m": [None, 1e9, -1e9],
    "*.mean_distance_m": [None, -1e9],
    "*.min_ttc_s": [0.0],
    "*.min_ttc_free_drift_s": [1e9],
    "*.drift_horizon_s": [1.0],
    "*.experimental_share": [0.51],
    "*.switches": [7],
    "*.collided": [True, False],
    "*.collided_runs": [3],
    "*.delta_v_m_s": [0.0, 1e9],
    "*.delta_v_max_m_s": [0.0, 1e9],
    "*.max_thrust_ratio": [0.0],
    "*.max_thrust_ratio_safety": [None, 0.5],
    "*.max_thrust_ratio_experimental": [None, 0.5],
}
"""Values of the right type that cannot stand beside the other numbers of a run of the scene below."""
ALONE = "schema_version scenario title created definitions versions synthesis.planner synthesis.seconds"
ALONE += " guarantee synthesis.share_bound.programs synthesis.share_bound.demands synthesis.share_bound.ended"
"""Words and what is compared elsewhere; of the effort of searches nothing follows."""


def test_every_number_of_a_summary_that_contradicts_another_is_refused(demanding):
    """A new number? It is compared with another one of the folder, or there is none to compare it with."""
    summary, patterns = demanding.tree("summary.json"), set()
    for at, value in places(summary):
        path = ".".join(map(str, at))
        if isinstance(value, dict) or any(f"{path}.".startswith(f"{alone}.") for alone in ALONE.split()):
            continue
        is_mode = at[0] in ("polaris", "safety", "experimental")
        patterns.add(pattern := ".".join(("*", *at[1:])) if is_mode else path)
        for other in CONTRARY[pattern]:
            if other == value or (at[0] == "experimental" and pattern.startswith(("*.min_d", "*.min_ttc_s"))):
                continue  # U alone may collide, of which nothing follows
            if (other is None) == ("ratio_" in path and value is None) and "ratio_" in path:
                continue
            files = {"summary.json": json.dumps(replaced(summary, at, other))}
            verdict = demanding.judge(files)
            assert (verdict.outcome, verdict.claim in ("summary", "margins")) == ("REJECTED", True), (
                path,
                other,
            )
    assert patterns == set(CONTRARY)


BETTER = {
    "guarantee.goal.by_s": [1.0, None],
    "guarantee.goal.distance_m": [0.0],
    "guarantee.goal.delta_v_max_m_s": [0.0],
    "guarantee.upkeep.settled_s": [0.0],
    "guarantee.upkeep.until_settled_m_s": [0.0],
    "guarantee.upkeep.rate_m_s2": [0.0],
    "guarantee.upkeep.lasts_s": [1e9, None],
    "guarantee.powered_abort.steps.*.delta_v_m_s": [0.0, None],
    "guarantee.abort.witness.after_s": [1e9],
    "guarantee.abort.witness.distance_m": [1.0],
    "steps.*.limit_time_s": [None, 0.0, 1e9],
    "steps.*.tightening": [None, 0.0],
    "steps.*.clearance": [None, 0.0, -1.0, 1e9],
}
"""Values for the last number of its kind in a schedule, where one more is worse or as good."""
DERIVED = "guarantee.goal", "guarantee.upkeep", "guarantee.abort.least_m"
"""Numbers that are compared with sets, which takes a second each."""
REASON = {"guarantee.abort.witness.middle_m", "rules.beam"}
"""What nothing follows from; `polaris verify` prints reasons as trusted."""


@pytest.mark.parametrize("derived", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_every_number_of_a_schedule_that_looks_better_is_refused(demanding, derived):
    """The summary repeats the guarantee. A new number? It is compared, derived, or printed as trusted."""
    last = {pattern(at): (at, x) for at, x in places(demanding.tree("schedule.json"))}
    assert set(last) >= {*BETTER, *REASON}
    passed = []
    for path, (at, value) in last.items():
        if isinstance(value, (str, dict, list)) or path in REASON or derived != path.startswith(DERIVED):
            continue
        more = not value if isinstance(value, bool) else 1.0 if value is None else value + 1
        for other in BETTER.get(path, [more]):
            lie = Lie(demanding)
            lie.schedule = replaced(lie.schedule, at, other)
            lie.summary["guarantee"] = lie.schedule["guarantee"]
            passed += [(path, other)] if lie.verdict().outcome == "VERIFIED" else []
    assert not passed


def test_a_margin_of_a_step_under_s_is_no_more_than_derived_nor_spending_than_claimed(demanding):
    """The need fits."""
    lie = Lie(demanding)
    k = max(k for k, step in enumerate(lie.schedule["steps"]) if step["mode"] == 0)
    step = lie.schedule["steps"][k]
    step |= {"margin": 0.99, "tightening": (1 - 0.99) * step["clearance"]}
    lie.judge({"margins", "recoverable"})
    lie = Lie(demanding)
    lie.summary["polaris"]["delta_v_max_m_s"] = 1.01 * lie.summary["guarantee"]["goal"]["delta_v_max_m_s"]
    lie.judge({"summary"})


@pytest.mark.parametrize(
    "change",
    [
        *({"step": "clear"}, {"step": 99}, {"t_s": 0.5}),
        *({"unsafe_set": "no"}, {"after_s": 1e9}, {"distance_m": 1.0}),
    ],
    ids=str,
)
def test_a_witness_is_of_a_drift_that_is_not_clear(demanding, change):
    lie = Lie(demanding)
    steps, witness = lie.certificate["drift"]["steps"], lie.schedule["guarantee"]["abort"]["witness"]
    assert steps[witness["step"]] is None
    if change == {"step": "clear"}:
        change = {"step": (k := next(k for k, step in enumerate(steps) if step)), "t_s": float(k)}
    witness |= change
    lie.summary["guarantee"] = lie.schedule["guarantee"]
    lie.judge({"passive"})
