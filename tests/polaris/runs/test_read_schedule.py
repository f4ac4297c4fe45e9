"""Schedules read from run folders: equal to those that were written, without planning."""

import json
import pickle
import shutil
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("flint")

from typer.testing import CliRunner

import polaris
from polaris.certificate.checker import verify
from polaris.certificate.files.document import canonical, digest
from polaris.certificate.files.structure import sha256
from polaris.cli.app import app
from polaris.model.errors import NotCertified, ScenarioError
from polaris.runs.case import load_target
from polaris.runs.certificate import certificate
from polaris.runs.read_schedule import read_schedule
from polaris.runs.schedule import write_run
from polaris.scenario.scenario import ScheduleScenario, load_scenario
from polaris.simulation.baselines import compare
from polaris.simulation.sampled import with_boxes
from polaris.simulation.simulate import simulate
from polaris.synthesis.safety.get_safety import SHARES
from polaris.synthesis.schedule.synthesize import Reflown, synthesize
from tests.polaris.corruptions import restate
from tests.polaris.forging import CERTIFICATE, COARSE, QUARTER
from tests.polaris.random_scenarios import synthesised
from tests.polaris.synthesis.controllers.test_black_box import document as box_document
from tests.polaris.synthesis.controllers.test_black_box import hasty
from tests.polaris.synthesis.controllers.test_neural import scene as network_scene
from tests.polaris.synthesis.sources.test_transients import LATE
from tests.polaris.tiny import TINY

SOLVERS = ("planning.lp.silent_highspy", "planning.backends.silent_highspy")
SEARCHES = (
    "synthesis.safety.attempts.plan",
    "synthesis.schedule.powered.plan",
    "scenario.experimental.plan",
    "synthesis.schedule.look_ahead.LookAhead.best",
    "synthesis.schedule.synthesize.best_schedule",
    "synthesis.schedule.synthesize.views",
    "synthesis.schedule.synthesize.within_budget",
)
"""Planners, and searches for modes."""


@contextmanager
def no_search(*more):
    """Make every planner, and every search for modes, fail, and what else is named."""

    def refuse(*args, **options):
        raise AssertionError("something is searched for")

    with pytest.MonkeyPatch.context() as patch:
        for place in (*SEARCHES, *more):
            patch.setattr(f"polaris.{place}", refuse)
        yield


def written(folder, scenario, schedule):
    """Path of a run folder with two flights of each controller."""
    return write_run(folder / "run", scenario, schedule, compare(schedule, 2, 0)).path


def assert_equal(actual, expected, scenario):
    """Check that two schedules have the same modes, sets and tubes, to the bit."""
    assert actual.modes.tolist() == expected.modes.tolist()
    assert [law.name for law in actual.controllers] == [law.name for law in expected.controllers]
    for one, other in zip(actual.steps, expected.steps, strict=True):
        assert np.array_equal(one.tube.nodes.c, other.tube.nodes.c)
        assert np.array_equal(one.tube.nodes.G, other.tube.nodes.G)
        assert np.array_equal(one.tube.intersample, other.tube.intersample)
        assert np.array_equal(one.tube.end.G, other.tube.end.G)
        assert one.margin == other.margin
    assert np.array_equal(actual.safety.reference.chi, expected.safety.reference.chi)
    assert actual.safety.start_margin == expected.safety.start_margin
    assert actual.arrival == expected.arrival and actual.delta_v == expected.delta_v
    texts = [json.dumps(certificate(each, scenario.name)) for each in (actual, expected)]
    assert texts[0] == texts[1]


def check(folder, scenario, schedule):
    """Check that a written schedule is read as it was, without any search; return it as it is read."""
    place = written(folder, scenario, schedule)
    with no_search(*SOLVERS):
        restored = read_schedule(place)
        assert_equal(restored, schedule, scenario)
    return restored


ERRORS = (
    "navigation.state_error=[0.002, 0.002, 0.0005, 0.0005]",
    "chaser.radius_m=0.02",
    "thrusters.magnitude_error=0.01",
)
ORBIT = 'orbit={kind="stationary",state=[0.0,6.0,0.0,0.0],tolerance_m=0.5}'
REPLAN = "recoverable.recourse=replan"
SOFT = "tracking.R=[60.0,60.0]"
VARIANTS = {
    "errors": (COARSE, SOFT, *ERRORS),
    "late faults": (QUARTER, SOFT, LATE),
    "passive abort": (COARSE, SOFT, "abort={drift_s=4.0}"),
    "powered abort": (QUARTER, f"abort={{{ORBIT},within_s=10.0,delta_v_max_m_s=20.0}}"),
    "powered abort to the goal": (QUARTER, 'abort={orbit={kind="goal"}}'),
    "setpoint": (QUARTER, 'experimental.0.reference={kind="setpoint",state=[8.0,6.0,0.0,0.0]}'),
    "shared": (QUARTER, 'experimental.0.reference={kind="shared"}'),
    "look ahead": (
        *(COARSE, SOFT, "schedule.strategy=look_ahead"),
        *("schedule.min_dwell_steps=2", "schedule.max_switches=3"),
    ),
    "budget": (COARSE, SOFT, "recoverable.recourse=none", "schedule.delta_v_max_m_s=7.0"),
    "balls": (COARSE, SOFT, "recoverable.kind=ball"),
}


LONG = "powered abort to the goal", "setpoint", "balls"
"""Variants of the long test: their parts are there apart."""


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name in LONG)) for name in VARIANTS]
)
def test_every_kind_of_choice_is_read(name, tmp_path):
    scenario = load_scenario(TINY).with_assignments(list(VARIANTS[name]))
    schedule = synthesize(scenario)
    restored = check(tmp_path, scenario, schedule)
    assert schedule.share() > 0 or name == "balls"
    assert schedule.safety.tracking.level == SHARES[name.startswith("errors")]  # the second of those tried
    assert restored.safety.tracking.level == schedule.safety.tracking.level
    if schedule.powered is not None:
        assert restored.powered.to_dict() == schedule.powered.to_dict()
    with no_search(*SOLVERS):
        library = list(restored.library)
    for one, other in zip(library, schedule.library, strict=True):
        assert_equal(one, other, scenario)
    if schedule.objective is not None:
        assert library or name == "budget"
        assert restored.objective({0: 0.2, 1: 0.8}, 1.5, 3) == schedule.objective({0: 0.2, 1: 0.8}, 1.5, 3)


@pytest.mark.parametrize("seed", [2, 2001, *(pytest.param(s, marks=pytest.mark.slow) for s in (5003, 5034))])
def test_random_scenes_are_read(seed, tmp_path):
    check(tmp_path, *synthesised(seed, tmp_path))


def damaged(folder, name, old, new):
    """Change a file without its hash."""
    data = (folder / name).read_bytes()
    (folder / name).write_bytes(data.replace(old, new, 1) if old else data + new)


def test_a_network_is_read(tmp_path):
    path = network_scene(tmp_path)
    scenario = load_scenario(path)
    schedule = synthesize(scenario)
    assert schedule.share() > 0
    check(tmp_path, scenario, schedule)


@pytest.mark.parametrize("kind", ["flies", pytest.param("may do anything", marks=pytest.mark.slow)])
def test_a_black_box_is_read_without_being_asked(kind, tmp_path):
    scenario = ScheduleScenario.from_dict(box_document())
    sampled = with_boxes(scenario, {"box": hasty()})
    schedule = sampled.schedule if kind == "flies" else sampled.proven
    restored = check(tmp_path, scenario, schedule)
    assert restored.guarantee == ("statistical" if kind == "flies" else "proved")
    assert restored.sampled_bound == schedule.sampled_bound
    if kind == "flies":
        with pytest.raises(ScenarioError, match="box.*must be given"):
            simulate(restored, 2, 0)
        with pytest.raises(ScenarioError, match="must be given with `polaris run"):
            load_target(str(tmp_path / "run")).schedule()
        with_box = load_target(str(tmp_path / "run")).schedule({"box": hasty()})
        assert np.array_equal(simulate(with_box, 2, 0).states, simulate(schedule, 2, 0).states)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A folder in which U flies, with a library, written to be copied."""
    scenario = load_scenario(TINY).with_assignments([QUARTER, REPLAN])
    return written(tmp_path_factory.mktemp("runs"), scenario, synthesize(scenario))


@pytest.fixture
def copied(run, tmp_path):
    return Path(shutil.copytree(run, tmp_path / "copy"))


def forge(folder, change, **texts):
    """Change the certificate, and other files by their names, a dot as an underscore; mend all hashes."""
    file = folder / "certificate.json"
    data = json.loads(file.read_text(encoding="utf-8"))
    change(data)
    for name, text in texts.items():
        (folder / name.replace("_", ".")).write_text(text, encoding="utf-8")
        data["artefacts"][name.replace("_", ".")] = sha256(folder / name.replace("_", "."))
    data["digest"] = digest(data)
    file.write_text(canonical(data), encoding="utf-8")


def test_what_is_no_run_folder_of_a_schedule_is_refused(tmp_path, copied):
    with pytest.raises(ScenarioError, match="there is no such folder"):
        read_schedule(tmp_path / "none")
    flight = polaris.run("inspection", tmp_path / "flight", overrides=["flight.duration_s=5"])
    with pytest.raises(ScenarioError, match="must be of a schedule; it is of kind 'inspection'"):
        read_schedule(flight)
    path = copied / "summary.json"
    path.write_text(path.read_text().replace('"schema_version": 2', '"schema_version": 1'))
    with pytest.raises(ScenarioError, match="has format version 1, not 2: run its scenario again"):
        _ = polaris.read_run(copied).summary


def push(data):
    inputs = data["reference"]["inputs"]
    inputs[0][0] = (float.fromhex(inputs[0][0]) + 1e-3).hex()


def later(data):
    data["horizon"] = "none"
    restate(data)


def another(folder, setting):
    """Put another scenario into a folder, with the hash that it has."""
    other = load_scenario(folder / "scenario.toml").with_assignments([setting]).to_toml()
    forge(folder, lambda data: None, scenario_toml=other)


REFUSED = [
    *(
        (lambda f, n=n: damaged(f, n, b"", b"\n"), "was edited or damaged")
        for n in ("scenario.toml", "tubes.npz")
    ),
    (lambda f: damaged(f, CERTIFICATE, b'"modes":[', b'"modes":[0,'), "was changed after .* its digest is"),
    (lambda f: (f / CERTIFICATE).unlink(), "has no certificate.json that can be read"),
    *(
        (
            lambda f, v=v: forge(f, lambda data: data.update(schema_version=v)),
            f"schema_version {v} .*reads .* 7: run the",
        )
        for v in (6, None)
    ),
    *(
        (lambda f, change=change: forge(f, change), message)
        for change, message in (
            (lambda data: data["artefacts"].pop("scenario.toml"), "no hash of scenario.toml"),
            (lambda data: data.update(modes=[1] * len(data["modes"])), "contradict each other in modes"),
            (push, "contradict each other in reference|cannot prove"),
            (later, "contradict each other in horizon"),
            (lambda data: data["controllers"][0]["gain"][0].__setitem__(0, (9.0).hex()), "in controllers"),
            (lambda data: data["system"].update(mass=(2.0).hex()), "in system"),
        )
    ),
    (lambda f: another(f, "system.disturbance_max=0.03"), "contradict each other in"),
    (lambda f: another(f, "system.disturbance_max=0.5"), "that this version cannot prove"),
    (lambda f: another(f, VARIANTS["powered abort"][-1]), "contradict each other in powered"),
]
"""Damage to a folder, and what it is refused with."""


@pytest.mark.parametrize(("damage", "message"), REFUSED, ids=range(len(REFUSED)))
def test_a_folder_that_was_altered_is_refused(damage, message, copied):
    damage(copied)
    with no_search(*SOLVERS), pytest.raises(ScenarioError, match=message):
        read_schedule(copied)


def test_a_library_that_is_not_proven_is_refused_when_it_is_needed(copied):
    def everywhere(data):
        for each in data["choices"]["library"]:
            each["modes"] = [1] * len(each["modes"])

    forge(copied, everywhere)
    schedule = read_schedule(copied)
    with pytest.raises(ScenarioError, match="must be proven"):
        list(schedule.library)
    assert polaris.simulate(schedule, 2).metrics().summary()["collided"] is False


def sooner(data):
    next(way for way in data["powered"]["steps"] if way)["cell"] -= 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (sooner, "contradict each other in powered.steps"),
        (
            lambda data: data["powered"]["branches"][0]["facets"].pop(),
            "is damaged|contradict each other|cannot prove",
        ),
    ],
)
def test_branches_that_were_forged_are_refused(change, message, tmp_path):
    """Nothing is planned in the place of what is missing."""
    scenario = load_scenario(TINY).with_assignments(list(VARIANTS["powered abort"]))
    folder = written(tmp_path, scenario, synthesize(scenario))
    forge(folder, change)
    with no_search(*SOLVERS), pytest.raises(ScenarioError, match=message):
        read_schedule(folder)


def test_a_schedule_that_is_read_can_be_pickled_and_written_again(run, tmp_path):
    first = read_schedule(run)
    restored = pickle.loads(pickle.dumps(first))
    scenario = load_scenario(run / "scenario.toml")
    assert_equal(restored, first, scenario)
    assert len(restored.library) == len(first.library) > 0
    other = written(tmp_path, scenario, restored)
    for name in ("certificate.json", "schedule.json", "tubes.npz", "sets.npz", "gains.json"):
        assert (other / name).read_bytes() == (run / name).read_bytes(), name
    assert verify(other).outcome == "VERIFIED"
    one = synthesize(scenario).library[0]  # which flies again where its tubes are asked for
    assert isinstance(one.steps, Reflown) and len(list(one.steps)) == len(one.modes)
    with pytest.raises(NotCertified, match="a second proof in its modes"):
        list(Reflown(one.steps.search, (1 - one.modes).tolist()))


@pytest.mark.parametrize(
    "command",
    [
        "falsify {run} --runs 60 --out {out}/case.json",
        "export {run} {out}/trace.json",
        "report {run} --out {out}/page.html",
        "compare {run} --runs 2 --methods schedule,monitor,safety --no-figures --out {out}/compared",
    ],
)
def test_no_command_on_a_run_folder_searches(command, copied, tmp_path):
    bound = "compare" in command  # what no schedule can exceed is bound anew, by linear programs
    with no_search(*SOLVERS * (not bound)):
        done = CliRunner().invoke(app, command.format(run=copied, out=tmp_path).split())
    assert done.exit_code == 0, done.output


def test_a_schedule_that_is_read_flies_and_is_monitored_like_the_one_that_was_written(run):
    scenario = polaris.load_scenario(run / "scenario.toml")
    original = synthesize(scenario)
    with no_search(*SOLVERS):
        read = read_schedule(run)
        runs = polaris.simulate(read, n=4, seed=1)
        aboard = polaris.Monitor.on(polaris.DecisionGrid.from_schedule(read, half_widths=0.001))
    assert np.array_equal(runs.states, polaris.simulate(original, n=4, seed=1).states)
    ground = polaris.Monitor.on(polaris.DecisionGrid.from_schedule(original, half_widths=0.001))
    at = polaris.Measurement(0.0, original.safety.problem.initial_set.c)
    answers = [polaris.OnlineMonitor(each).step(0.0, at) for each in (aboard, ground)]
    assert answers[0] == answers[1] and np.array_equal(aboard.grid.xi, ground.grid.xi)
    pytest.importorskip("gymnasium")
    from polaris.runs.training import SwitchingVectorEnv

    with no_search(*SOLVERS):
        env = SwitchingVectorEnv(run, num_envs=2, half_widths=0.001)
    assert env.reset(seed=0)[0].shape[0] == 2
