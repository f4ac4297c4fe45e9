"""Claims of a run beside safety, against what its scenario demands and the rest of its folder."""

import json
import math
import tomllib

import numpy as np
import pytest

pytest.importorskip("flint")

from polaris.certificate.checker import verify
from polaris.certificate.files.demands import CHECKED, NO_DEMAND, UNCHECKED, listed
from polaris.certificate.files.scenario_keys import SCENARIO
from polaris.certificate.files.structure import Items, OneOf
from polaris.model.errors import ScenarioError
from polaris.report import write_report
from polaris.report.figures import draw_run
from polaris.report.sentences import goal as _goal
from polaris.runs.files.arrays import read_arrays, tube_arrays
from polaris.runs.run import run
from polaris.scenario.reading import write_toml
from polaris.scenario.scenario import load_scenario
from polaris.scenario.tables.methods import ScheduleTable
from polaris.simulation.simulate import simulate
from polaris.synthesis.schedule.synthesize import synthesize
from tests.polaris.certificate.test_forged_runs import NO_CLAIM
from tests.polaris.forging import QUARTER, Forger, Lie, make, pattern, places, replaced
from tests.polaris.tiny import TINY

CORNER = (
    "initial_set.center=[1.0,1.0,0.0,0.0]",
    'obstacles=[{kind="polytope",name="wall",normals=[[2.0,0.0]],offsets_m=[0.0],unbounded=true},'
    '{kind="polytope",name="wedge",normals=[[1.0,-1.0],[-1.0,4.0]],offsets_m=[0.0,-0.0],unbounded=true}]',
    'keep_in=[{kind="polytope",name="quadrant",normals=[[0.0,-1.0],[-1.0,3e-9]],offsets_m=[0.0,0.0]},'
    '{kind="cone",name="cone",apex_m=[0.0,0.0],axis=[1.0,1.0],half_angle_deg=80.0}]',
)
"""Every set has its facets through the origin."""


@pytest.mark.slow
def test_a_scene_of_walls_through_the_origin_is_proven_drawn_and_verified(tmp_path):
    assignments = [QUARTER, "simulation.runs=2", "schedule.bound_programs=0", *CORNER]
    made = run(TINY, tmp_path / "run", overrides=assignments, draw=draw_run)
    assert made.summary["guarantee"]["kind"] == "proved"
    write_report(made.path)
    verdict = verify(made.path)
    assert verdict.outcome == "VERIFIED", verdict.text()


# -- tubes.npz --------------------------------------------------------------------------------------

SOFT = (
    *("feedback={period_s=0.25}", "tracking.Q=[0.1,0.1,0.1,0.1]", "tracking.R=[10.0,10.0]"),
    *("initial_set.half_widths=[0.0005,0.0005,0.0001,0.0001]", "system.disturbance_max=0.0001"),
    *("experimental.0.Q=[0.1,0.1,0.1,0.1]", "experimental.0.R=[10.0,10.0]"),
    *('experimental.0.reference={kind="shared"}', "planner.extra_margin_m=0.0"),
    'obstacles=[{kind="ball",name="far",center_m=[0.0,60.0],radius_m=1.0}]',
)
"""Next to no feedback: what displaces flights is not hidden in what they need to answer it."""
BIT = "thrusters.impulse_bit_N_s=0.02"
DISPLACED = {
    "carried": [BIT, "thrusters.remainder=carried"],
    "carried, of another size": [BIT, "thrusters.remainder=carried", "thrusters.magnitude_error=0.05"],
    "carried and pulsed": [BIT, "thrusters.remainder=carried", "thrusters.pulse=centred"],
    "pulsed": ["thrusters.pulse=centred"],
    "early or late": ["timing.jitter_s=0.02"],
}


@pytest.mark.parametrize("kind", DISPLACED)
def test_flights_are_inside_the_sets_of_the_file_at_nodes_and_between(kind, tmp_path):
    """Along random rows, each flight against the zonotopes as they are read; some use most of them."""
    schedule = synthesize(load_scenario(TINY).with_assignments([*SOFT, *DISPLACED[kind]]))
    np.savez(tmp_path / "tubes.npz", **tube_arrays(schedule))
    file, runs = read_arrays(tmp_path / "tubes.npz"), simulate(schedule, 150, 0, initial="corners")
    (K, q), system = file["intersample"].shape[:2], schedule.safety.problem.system
    at = np.arange(K)[:, None] * q + np.arange(q + 1)
    errors = runs.states[:, at] - schedule.safety.reference.fine(q)[:K]
    within = between(runs, schedule, parts=20).reshape(len(errors), K, q, -1, system.n)
    largest, rng = 0.0, np.random.default_rng(0)
    for row in [*np.eye(system.n), *rng.normal(size=(20, system.n))]:
        middle, intersample = file["center_error"] @ row, file["intersample"] @ np.abs(row)
        half = np.abs(file["generators"].astype(float) @ row).sum(axis=1).T
        share = np.abs(errors @ row - middle) / half
        assert np.all(share <= 1 + 1e-6)
        largest = max(largest, float(share[:, :, 1:].max()))
        low, high, along = middle - half, middle + half, within @ row
        off = system.w_max * schedule.safety.tracking.flow.h  # `between` knows of none
        assert np.all(along >= (np.minimum(low[:, :-1], low[:, 1:]) - intersample - off)[..., None])
        assert np.all(along <= (np.maximum(high[:, :-1], high[:, 1:]) + intersample + off)[..., None])
    last = np.abs(errors[:, -1, -1] - file["final_center_error"])
    assert np.all(last <= np.abs(file["final_generators"]).sum(axis=1) + 1e-9)
    assert largest > (0.4 if "carried" in kind else 0.02)  # of what is carried at the start, too


def between(runs, schedule, parts):
    """Errors within every period of a double integrator under the thrust that was applied, held or pulsed."""
    h, fired = schedule.safety.tracking.flow.h, np.array(schedule.safety.problem.system.timing.pulse_thrust)
    ends, u = np.linspace(-0.5, 0.5, parts + 1)[:, None], runs.inputs[:, :, None]
    if len(fired):
        on = np.abs(u) / fired / 2
        u = np.sign(u) * fired * np.maximum(np.minimum(on, ends[1:]) - np.maximum(-on, ends[:-1]), 0) * parts
    nu = np.repeat(schedule.safety.reference.nu, runs.inputs.shape[1] // schedule.safety.problem.K, axis=0)
    K, count = schedule.safety.problem.K, runs.inputs.shape[1]
    start = runs.states[:, :-1] - np.vstack([*schedule.safety.reference.fine(count // K)[:K, :-1]])
    d = np.cumsum(u - nu[:count, None] + np.zeros((parts, 1)), axis=2) * h / parts
    d = start[:, :, None, 2:] + np.concatenate([0 * d[:, :, :1], d], axis=2)
    p = start[:, :, None, :2] + np.cumsum((d[:, :, 1:] + d[:, :, :-1]) / 2, axis=2) * h / parts
    return np.concatenate([p, d[:, :, 1:]], axis=-1)


# -- order of states --------------------------------------------------------------------------------

CART = {
    "system": {
        "kind": "linear",
        "A": [
            [0.0, 1.0, 0.0],
            [0.0, 0.0, 1.0],
            [0.0, 0.0, -4.0],
        ],  # position, velocity, force of a slow motor
        **{"B": [[0.0], [0.0], [4.0]], "D": [[0.0], [1.0], [0.0]], "input_max": 1.0},
        **{"disturbance_max": 0.01, "position_states": [0]},
    },
    "initial_set": {"kind": "box", "center": [0.0, 0.0, 0.0], "half_widths": [0.02, 0.01, 0.01]},
    "tracking": {"Q": [1.0, 1.0, 1.0], "R": [1.0]},
    "goal": {"kind": "box", "center": [3.0, 0.0, 0.0], "half_widths": [0.01, 0.02, 0.5]},
    "obstacles": [
        {"kind": "polytope", "name": "wall", "normals": [[-1.0]], "offsets_m": [-4.0], "unbounded": True}
    ],
    "experimental": [{"kind": "saturated_affine", "name": "u", "Q": [2.0, 1.0, 1.0], "R": [1.0]}],
}
"""An odd number of states, one of which is neither position nor velocity."""


def in_order(scenario, order):
    """Return the scenario with its states in another order."""
    scenario = {**scenario}
    system, place = scenario["system"], [order.index(i) for i in range(len(order))]
    matrices = {"A": [[system["A"][i][j] for j in order] for i in order]}
    matrices |= {key: [system[key][i] for i in order] for key in "BD"}
    first = system.get("position_states", range(len(order) // 2))
    scenario["system"] = system | matrices | {"position_states": [place[i] for i in first]}

    def turned(table):
        """Lists with a number for every state; tables within, too."""
        for key, value in table.items():
            if isinstance(value, dict):
                value = turned(value)
            elif key in ("center", "half_widths", "state", "Q"):
                value = [value[i] for i in order]
            table = table | {key: value}
        return table

    for name in ("initial_set", "goal", "tracking"):
        scenario[name] = turned(scenario[name])
    scenario["experimental"] = [turned(each) for each in scenario["experimental"]]
    return scenario


@pytest.mark.parametrize(
    ("change", "orders"),
    [pytest.param({}, ([0, 1, 2, 3], [3, 0, 2, 1]), marks=pytest.mark.slow), (CART, ([0, 1, 2], [1, 2, 0]))],
    ids=["robot", "cart"],
)
def test_the_order_of_states_changes_no_claim(change, orders, tmp_path):
    """Velocities are those of the position, wherever they stand, to the synthesis and to the checker."""
    base = tomllib.loads(TINY.read_text(encoding="utf-8")) | change
    base |= {"feedback": {"period_s": 0.25}, "simulation": {"runs": 2}}
    base |= {"schedule": {"bound_programs": 0}}
    claims = []
    for order in orders:
        file = tmp_path / f"{order}.toml"
        file.write_text(write_toml(in_order(base, order)), encoding="utf-8")
        made = run(file, tmp_path / "run")
        assert verify(made.path).outcome == "VERIFIED"
        claims.append(made.summary["guarantee"]["goal"])
        assert claims[-1].pop("drift_m_per_orbit") is None
    for claim in claims:
        assert claim == pytest.approx(claims[0], rel=1e-3)  # weights of sums are found by ascent
    assert claims[0]["velocity_time_s"] == 3.0  # a quarter of 12 s


# -- velocities -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("most", "reached"), [(0.5, True), pytest.param(0.005, "not_proven", marks=pytest.mark.slow)]
)
def test_velocities_have_a_tolerance_of_their_own(most, reached, tmp_path):
    """A goal claimed as reached is within both, to the checker too, which refuses a narrower one."""
    near = ["goal.tolerance_m=2.0", f"goal.velocity_tolerance_m_s={most}", "schedule.bound_programs=0"]
    forger = Forger(make([QUARTER, *near], tmp_path), tmp_path)
    assert forger.judge({}).outcome == "VERIFIED"
    lie = Lie(forger)
    goal = lie.schedule["guarantee"]["goal"]
    assert goal["reached"] == reached and goal["velocity_time_s"] == pytest.approx(2.0 / most)
    assert (goal["distance_m"] <= 2.0) == (reached is True)
    lie.scenario["goal"]["velocity_tolerance_m_s"] = 0.9 * most
    lie.judge({"goal"})
    lie = Lie(forger)
    for name in ("schedule", "summary"):
        getattr(lie, name)["guarantee"]["goal"]["velocity_time_s"] = 1.0
    lie.judge({"goal"})


def test_flights_keep_both_tolerances():
    near = [QUARTER, "goal.tolerance_m=0.5", "goal.velocity_tolerance_m_s=0.1"]
    schedule = synthesize(load_scenario(TINY).with_assignments(near))
    runs, arrival = simulate(schedule, 200, 0, disturbance="worst", tail=True), schedule.arrival
    off = np.abs(runs.states[:, round(arrival.by / 0.25)] - [8.0, 6.0, 0.0, 0.0]).max(axis=0)
    assert arrival.distance <= 0.5 and np.all(off[:2] <= 0.5) and 0.03 < off[2:].max() <= 0.1


def test_the_orbit_of_an_abort_has_a_tolerance_of_velocities_too(tmp_path):
    """Aborted flights arrive slowly enough, by the schedule's claim and by the checker's."""
    orbit = '{kind="stationary",state=[0.0,6.0,0.0,0.0],tolerance_m=0.5,velocity_tolerance_m_s=0.05}'
    asked = [QUARTER, f"abort={{orbit={orbit},within_s=14.0}}", "schedule.bound_programs=0"]
    forger = Forger(make(asked, tmp_path), tmp_path)
    assert forger.judge({}).outcome == "VERIFIED"
    schedule = synthesize(load_scenario(TINY).with_assignments([*asked, "tracking.R=[60,60]"]))
    k, way = next((k, way) for k, way in enumerate(schedule.powered.ways) if way.branch is not None)
    runs = simulate(schedule.aborted(k), 40, 0, disturbance="worst", tail=True)
    off = np.abs(runs.states[:, way.cell * 4] - [0.0, 6.0, 0.0, 0.0]).max(axis=0)
    assert np.all(off <= [0.5, 0.5, 0.05, 0.05])
    lie = Lie(forger)
    lie.scenario["abort"]["orbit"]["velocity_tolerance_m_s"] = 0.001
    lie.judge({"powered_abort"})


ANY = [1.0, 1.0, float("inf"), float("inf")]
MIXED = {
    **{"A": [[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0] * 4, [0.0] * 4]},
    **{
        "B": [[0.5, 0.0], [0.0, 0.5], [1.0, 0.0], [0.0, 1.0]],
        "C": [[1.0, 0.0, -0.5, 0.0], [0.0, 1.0, 0.0, 0.0]],
    },
}
"""The robot, one state of which is a position plus half a velocity: that velocity is part of the position."""


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        ({"system": MIXED}, "has no velocity among the states"),
        pytest.param(
            {"goal": {"kind": "box", "center": [8.0, 6.0, 0.0, 0.0], "half_widths": ANY}},
            "sets no condition on velocities",
            marks=pytest.mark.slow,
        ),
    ],
    ids=["mixed", "any"],
)
def test_a_tolerance_of_velocities_without_effect_is_refused(change, rule, tmp_path):
    """A run that is far faster would count as reached, to the checker too."""
    base = load_scenario(TINY).with_assignments([QUARTER, "goal.tolerance_m=2.0"]).to_dict()
    base |= {"schedule": {"bound_programs": 0}, "simulation": {"runs": 2}}
    base["system"] |= change.get("system", {})
    base["goal"] = change.get("goal", base["goal"]) | {"tolerance_m": 2.0}
    if "system" in change:
        base["system"].pop("position_states", None)
    file = tmp_path / "scene.toml"
    file.write_text(write_toml(base), encoding="utf-8")
    lie = Lie(Forger(run(file, tmp_path / "run").path, tmp_path))
    lie.scenario["goal"]["velocity_tolerance_m_s"] = 1e-6
    lie.judge({"goal"})
    scenario = load_scenario(file).with_assignments(["goal.velocity_tolerance_m_s=1e-6"])
    with pytest.raises(ScenarioError, match=f"goal.velocity_tolerance_m_s.*{rule}"):
        synthesize(scenario)


def test_a_tolerance_of_velocities_needs_one_of_lengths():
    with pytest.raises(ScenarioError, match="must be given with velocity_tolerance"):
        load_scenario(TINY).with_assignments(["goal.velocity_tolerance_m_s=0.1"])


@pytest.mark.parametrize("drift", [None, 73.7])
def test_the_line_of_the_goal_says_when_how_near_and_what_holds_it(drift):
    claim = {"reached": True, "by_s": 1958.0, "distance_m": 3.9, "tolerance_m": 4.0}
    cost = {"velocity_time_s": 450.0, "drift_m_per_orbit": drift, "delta_v_max_m_s": 1.3}
    line = _goal(claim | cost)
    assert line.startswith("reached at 1958 s, within 3.9 m (the tolerance is 4 m; velocity errors count as")
    assert "S must fly on to stay there" in line and ("m per orbit" in line) == (drift is not None)


# -- what a scenario demands ------------------------------------------------------------------------


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


def test_every_limit_on_a_schedule_has_a_tighter_one():
    """A new one? Enter it into `DEMANDING` and `TIGHTER`."""
    assert {key for claim in ("schedule", "upkeep") for key in listed(CHECKED[claim])} <= set(TIGHTER)


def test_what_is_demanded_and_not_checked_is_printed(demanding):
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


# -- numbers of one folder --------------------------------------------------------------------------

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
    summary, seen = demanding.tree("summary.json"), set()
    for at, value in places(summary):
        path = ".".join(map(str, at))
        if isinstance(value, dict) or any(f"{path}.".startswith(f"{alone}.") for alone in ALONE.split()):
            continue
        flown = at[0] in ("polaris", "safety", "experimental")
        seen.add(pattern := ".".join(("*", *at[1:])) if flown else path)
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
    assert seen == set(CONTRARY)


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


def test_a_margin_of_a_step_under_s_is_no_more_than_derived(demanding):
    """The need fits."""
    lie = Lie(demanding)
    k = max(k for k, step in enumerate(lie.schedule["steps"]) if step["mode"] == 0)
    step = lie.schedule["steps"][k]
    step |= {"margin": 0.99, "tightening": (1 - 0.99) * step["clearance"]}
    lie.judge({"margins", "recoverable"})


def test_runs_that_spend_more_than_is_claimed_are_refused(demanding):
    lie = Lie(demanding)
    lie.summary["polaris"]["delta_v_max_m_s"] = 1.01 * lie.summary["guarantee"]["goal"]["delta_v_max_m_s"]
    lie.judge({"summary"})


def test_a_witness_may_lie_in_the_last_of_the_whole_steps_that_a_drift_is_followed_over(demanding):
    lie = Lie(demanding)
    abort, delta = lie.schedule["guarantee"]["abort"], lie.schedule["step_s"]
    steps = math.ceil(abort["drift_s"] / delta) + 1
    assert abort["drift_s"] % delta > 0
    for after, claim in (((steps + 0.01) * delta, "passive"), (steps * delta, "")):
        abort["witness"]["after_s"] = after
        lie.summary["guarantee"] = lie.schedule["guarantee"]
        verdict = lie.verdict()
        assert verdict.claim == claim and (verdict.outcome == "VERIFIED") == (not claim), verdict.text()


@pytest.mark.parametrize(
    "change",
    [
        {"step": "clear"},
        {"step": 99},
        {"t_s": 0.5},
        {"unsafe_set": "no"},
        {"after_s": 1e9},
        {"distance_m": 1.0},
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
