"""Navigation by phase (Proposition 4), and an observer on board: bounds, sets, certificates and flights."""

import numpy as np
import pytest
from scipy.linalg import expm

from polaris import KeepInPolytope, falsify, get_safety, load_scenario, run, synthesize
from polaris.certificate.checker import verify, verify_document
from polaris.certificate.files.document import Document
from polaris.certificate.kernel.verdict import Rejected
from polaris.certificate.model.navigation import measured_errors
from polaris.model.errors import SynthesisInfeasible
from polaris.runs.certificate import certificate
from polaris.scenario.reading import write_toml
from polaris.simulation.delayed import Predicting
from polaris.simulation.disturbances import adjoint_worst_case, limit_rows
from polaris.simulation.simulate import flown_modes, simulate
from tests.kept import kept
from tests.polaris.closed_loops import attack
from tests.polaris.corruptions import scaled
from tests.polaris.forging import Forger, Lie, make
from tests.polaris.model.test_timing import fly_delayed
from tests.polaris.synthesis.safety.test_closed_loops import judge
from tests.polaris.synthesis.sources.test_error_sources import exact
from tests.polaris.synthesis.sources.test_transients import pulsing
from tests.polaris.tiny import TINY

SAMPLED = ("feedback.period_s=0.25", "tracking.R=[60,60]")
MEASURED = (
    "navigation.measurement.matrix=[[1,0,0,0],[0,1,0,0]]",
    "navigation.measurement.error=[0.005, 0.005]",
)
PHASED = (
    "navigation.state_error=[0.01, 0.01, 0.004, 0.004]",
    "navigation.phases=[{from_s=3.0, state_error=[0.002, 0.002, 0.001, 0.001]},"
    " {from_s=8.5, state_error=[0.006, 0.0, 0.003, 0.003]}]",
)
FIRST = "navigation.measurement.initial={state_error=[0.03, 0.03, 0.01, 0.01]}"
SMALL = "navigation.measurement.error=[0.002, 0.002]"
RANGED = (
    "navigation.state_error=[0.01, 0.01, 0.004, 0.004]",
    "navigation.phases=[{from_s=0.5, within_m=[9.0, 7.0], state_error=[0.004, 0.004, 0.002, 0.002]},"
    " {from_s=8.5, within_m=[8.2, 6.2], state_error=[0.002, 0.002, 0.001, 0.001]}]",
)


def scene(*assignments):
    return load_scenario(TINY).with_assignments([*SAMPLED, *assignments])


def observed(name, *more):
    """The tiny scene with an observer."""
    return kept(f"observed-{name}", lambda: synthesize(scene(*MEASURED, *more)))


@pytest.mark.parametrize("name", ["tiny", "static"])
def test_bounds_of_an_observer_are_what_its_worst_noise_and_pushes_reach(name):
    hill = ("feedback.period_s=2.0", "navigation.measurement.position_error_m=0.1")
    scenario = scene(*MEASURED) if name == "tiny" else load_scenario("static").with_assignments(hill)
    system, h, parts = scenario.system(), scenario.problem().period, 10
    observer, n = system.observer, system.n
    transition, reached = np.eye(n), np.zeros(n)
    step, small = expm(system.A * h), expm(system.A * h / parts)
    for _ in range(600):
        back = transition @ observer.rest @ expm(system.A * h / parts / 2)
        for _ in range(parts if np.abs(transition).max() > 1e-9 else 0):
            reached += np.linalg.norm(back @ system.D, axis=1) * system.w_max * h / parts
            back = back @ small
        reached += np.abs(transition @ observer.gain) @ observer.noise
        transition = transition @ observer.rest @ step
    assert np.all(reached <= system.navigation * (1 + 1e-6))
    assert np.all(reached >= 0.98 * system.navigation)


def test_errors_of_a_phase_count_in_its_steps_alone():
    plain, phased = scene(PHASED[0]), scene(*PHASED)
    system, steps = phased.system(), phased.system().error_by_step
    assert steps.shape == (13, 4) and steps[:, 0].tolist() == [0.01] * 3 + [0.002] * 5 + [0.006] * 5
    assert np.array_equal(system.navigation, plain.system().navigation)
    assert np.array_equal(system.at_step(99).navigation, steps[-1])
    late = scene(*PHASED, "timing.delay_s=0.5").system().error_by_step
    assert np.all(late >= steps) and np.all(late[3] >= late[0] - 1e-12) and np.all(late[4] < late[0])
    schedule = kept("phased", lambda: synthesize(phased))
    judge(0, attack(schedule, 40, 0))
    assert falsify(schedule, 100, 0).failure is None
    wrong = np.repeat(20 * steps.max(axis=0)[None], 13, axis=0)
    object.__setattr__(schedule.safety.problem.system, "error_by_step", wrong)
    assert attack(schedule, 40, 0).over > 1e-3  # the attack would find errors that are left out
    object.__setattr__(schedule.safety.problem.system, "error_by_step", steps)


def test_first_errors_of_an_observer_fade_as_its_loop_says():
    schedule, plain = observed("first", FIRST), scene(*MEASURED).system()
    system, h = schedule.safety.problem.system, 0.25
    loop, first = system.observer.rest @ expm(system.A * h), system.observer.initial
    errors = np.array([np.abs(np.linalg.matrix_power(loop, k)) @ first for k in range(200)])
    expected = [errors[4 * k : 4 * k + 4].max(axis=0) for k in range(12)] + [errors[48:].max(axis=0)]
    assert np.allclose(system.error_by_step, plain.navigation + expected, rtol=1e-6)
    _, shares = fly_delayed(schedule, 60, 1, 1)
    assert np.all(shares <= 1) and shares.max() > 0.75
    zero = scene(*MEASURED, FIRST.replace("0.03", "0").replace("0.01", "0")).system()
    assert zero.observer.initial is None and np.array_equal(zero.navigation, plain.navigation)


def test_a_camera_knows_the_velocity_once_s_has_settled():
    """It measures the position within 10 cm: errors of thrusters count at what is commanded."""
    errors = ("thrusters.magnitude_error=0.05", "thrusters.misalignment_deg=2", "thrusters.mass_error=0.03")
    assignments = ["feedback.period_s=2.0", "navigation.measurement.position_error_m=0.1", "timing.delay_s=2"]
    safety = get_safety(load_scenario("static").with_assignments([*assignments, *errors]).problem())
    tracking = safety.tracking
    estimate_error = tracking.settled_tightening(tracking.estimate_error_rows) + tracking.unremembered(
        tracking.system.u_max
    )
    assert estimate_error[:3].max() < 0.19 and 0.008 < estimate_error[3:].max() < 0.0086
    assert tracking.system.navigation[3:].max() > 10 * estimate_error[3:].max()  # at full thrust


def test_an_observer_is_attacked_by_its_noise():
    schedule, rng = observed("noise", FIRST, "timing.delay_s=0.5"), np.random.default_rng(0)
    modes, rows, runs = flown_modes(schedule, False), limit_rows(schedule), 30
    flight = Predicting(schedule, modes, 1)
    rows, targets = rows[rng.integers(0, len(rows), runs)], rng.integers(5, flight.steps + 1, runs)
    w, _, _ = adjoint_worst_case(flight, rows, targets)
    x0 = np.repeat(schedule.safety.problem.initial_set.c[None], runs, axis=0)
    attacked = flight.run(x0, w)
    assert np.all(flight.error_share <= 1 + 1e-9) and flight.error_share.max() > 0.5
    for _ in range(3):
        other = w.copy()
        noise = other[..., flight.columns[1]]
        other[..., flight.columns[1]] = noise * rng.choice([-1.0, 1.0], (*noise.shape[:2], 1))
        change = (flight.run(x0, other).states - attacked.states)[np.arange(runs), targets]
        further = np.sum(rows * change, axis=1)
        assert further.max() < 0.02 and further.mean() < -0.005  # some commands clip, and some are early


def test_bounds_hold_within_a_range_that_is_kept():
    schedule = kept("ranged", lambda: synthesize(scene(*RANGED)))
    errors = schedule.safety.problem.system.error_by_step
    assert errors[:, 0].tolist() == [0.01] + [0.004] * 8 + [0.002] * 4
    runs = simulate(schedule, 60, 1)
    assert not runs.metrics().collided.any() and falsify(schedule, 100, 1).failure is None
    p, late = np.abs(runs.states[..., :2]), runs.times >= 8.0
    assert np.all(p[:, late] < [8.2, 6.2]) and np.all(p < [9.0, 7.0])
    ranges = {item.name: item for item in schedule.safety.clearance.unsafe if item.name.startswith("within")}
    assert len(ranges) == 8 and ranges["within-1[0]"].offsets[7, 1, 0] == pytest.approx(-8200)
    assert ranges["within-1[0]"].offsets[8, 0, 0] == pytest.approx(-8.2) and ranges["within-1[3]"].static
    box, system = np.vstack([np.eye(2), -np.eye(2)]), scene().system()
    for begins, ends, static in ((3.0, np.inf, 1), (3.0, 5.0, 1), (12.0, np.inf, 0), (0.0, 20.0, 0)):
        late = KeepInPolytope("late", box, np.ones(4), begins, ends)
        assert late.timed_polytopes(system, 1.0, 12)[0].static == static  # or nothing is claimed for ever
    with pytest.raises(SynthesisInfeasible, match="margins required from the unsafe sets"):
        synthesize(scene(RANGED[0], RANGED[1].replace("[8.2, 6.2]", "7.0")))


MISSED = "timing.missed_periods=2"
NEAR = "navigation.measurement.initial={state_error=[0.006, 0.006, 0.003, 0.003]}"


def test_bounds_hold_for_every_pattern_of_missed_periods_and_some_reach_them():
    scenario, rng, share = scene(*MEASURED, MISSED, FIRST), np.random.default_rng(1), 0.0
    system, h, parts = scenario.system(), 0.25, 40
    observer, bound = system.observer, np.array(system.timing.measured_error)
    small, push_map = expm(system.A * h / parts), expm(system.A * h / parts / 2) @ system.D
    for likely in np.linspace(0, 1, 60):
        transition, reached, age = np.eye(system.n), np.zeros(system.n), rng.integers(0, 8)
        while age > 0:
            j = 0 if rng.random() < likely else int(rng.integers(1, 3))
            reached += np.abs(transition @ (observer.gain, *observer.after)[j]) @ observer.noise
            transition, age = transition @ observer.rests[j], age - j - 1
            for _ in range(parts * (j + 1)):
                reached += np.linalg.norm(transition @ push_map, axis=1) * system.w_max * h / parts
                transition = transition @ small
        reached += np.abs(transition) @ observer.initial
        share = np.maximum(share, reached / bound)
    assert np.all(share <= 1 + 1e-6) and share.max() > 0.9


LED = SMALL, "thrusters.pulse='start'", "thrusters.magnitude_error=0.01", "feedback.period_s=0.1"


PULSED = "timing.delay_s=0.3", "thrusters.pulse='centred'"
BESIDE = [
    (MISSED,),
    (MISSED, SMALL, *PULSED, NEAR),
    (MISSED, *LED),
    ("thrusters={impulse_bit_N_s=0.001,remainder='carried'}",),
    pytest.param((FIRST, *PULSED), marks=pytest.mark.slow),
]


@pytest.mark.parametrize("more", BESIDE, ids=str)
def test_observers_go_with_all_else(more):
    schedule = observed("-".join(["beside", *more]), *more)
    assert verify_document(certificate(schedule, "tiny")).outcome == "VERIFIED"
    shares = fly_delayed(schedule, 60, 1, 1)[1]
    assert np.all(shares <= 1 + 1e-6) and shares.max() > 0.3
    assert falsify(schedule, 60, 1).failure is None


FORGED = SMALL, FIRST, "thrusters.pulse='centred'", "timing.delay_s=0.25"


AGED = SMALL, MISSED, "thrusters.magnitude_error=0.02"


@pytest.mark.parametrize("more", [(), FORGED, AGED])
def test_forged_observers_are_refused(more, tmp_path):
    forger = Forger(make([*SAMPLED[:2], *MEASURED, *more], tmp_path), tmp_path)
    assert forger.judge({}).outcome == "VERIFIED"
    data = forger.honest["system"]
    observer = data["observer"]
    error_keys = [key for key in ("estimate_error", "error_by_step") if data.get(key)]
    lies = [{"observer": observer | {"gain": scaled(observer["gain"], 0.5)}}]
    lies += [{key: scaled(data[key], 0.999) for key in error_keys}]
    other = [{"noise": [(0.001).hex()] * 2}]  # what is refused by another claim, perhaps
    if MISSED in more:
        lies += [{"observer": observer | {"after": scaled(observer["after"], 0.5)}}]
        lies += [
            {"timing": data["timing"] | {"measured_error": scaled(data["timing"]["measured_error"], 0.99)}}
        ]
        other += [{"after": observer["after"][:1]}]
        ages, smaller = observer["by_age"], scaled(observer["by_age"], 0.99)
        other += [{"by_age": [smaller[0], *ages[1:]]}, {"by_age": [ages[0], *smaller[1:]]}, {"followed": 0}]
        other += [{"ages": [age - 1 if age else 0 for age in observer["ages"]]}]
    elif more:
        other += [{key: scaled(observer[key], 0.99)} for key in ("settled", "initial")]
    for lie in lies:
        verdict = forger.forged(lambda honest, lie=lie: honest["system"].update(lie))
        assert (verdict.outcome, verdict.claim) == ("REJECTED", "system"), lie
    for lie in other:
        verdict = forger.forged(lambda honest, lie=lie: honest["system"]["observer"].update(lie))
        assert verdict.outcome == "REJECTED", lie
    if more != FORGED:  # errors that are stated twice: nothing would verify these
        lie = Lie(forger)
        lie.certificate["system"]["observer"]["settled"] = [(0.0).hex()] * 4
        lie.judge({"system"})
    for phase in ("settled", "experimental"):  # what the run says that they may be off by
        lie, changed = Lie(forger), forger.tree("schedule.json")["guarantee"]["estimate"]
        changed |= {phase: [0.9 * x for x in changed[phase]]}
        lie.schedule["guarantee"]["estimate"] = lie.summary["guarantee"]["estimate"] = changed
        lie.judge({"goal"})
    document, honest = Document(forger.honest), forger.tree("scenario.toml")
    assert len(measured_errors(document, honest)) == (13 if FIRST in more else 1)
    document.transients = [{"name": "stuck_on", "pushes": [[1.0, 0.0]]}]
    with pytest.raises(Rejected, match="late thruster faults are not covered"):
        measured_errors(document, honest | {"timing": {"missed_periods": 1}})
    honest["navigation"]["measurement"]["error"] = [0.0051, 0.005]
    assert forger.judge({"scenario.toml": write_toml(honest)}).outcome == "REJECTED"


RANGE_LIES = [{"within_m": [8.1, 6.2]}, {"within_m": [8.2]}, {"from_s": 6.5}, {"from_s": 12.0}]
RANGE_LIES += [{"state_error": [0.003, 0.002, 0.001, 0.001]}]


def test_forged_ranges_and_phases_are_refused(tmp_path):
    forger = Forger(make([*SAMPLED[:2], *RANGED], tmp_path), tmp_path)
    assert forger.judge({}).outcome == "VERIFIED"
    for lie in (*RANGE_LIES, {}):
        scenario = forger.tree("scenario.toml")
        scenario["navigation"]["phases"][1] |= lie
        if not lie:
            del scenario["navigation"]["phases"][1]["within_m"]
        assert forger.judge({"scenario.toml": write_toml(scenario)}).outcome == "REJECTED", lie
    steps = forger.honest["system"]["error_by_step"]
    for k in (3, 12):
        less = [scaled(row, 0.999) if k == i else row for i, row in enumerate(steps)]
        verdict = forger.forged(lambda data, less=less: data["system"].update(error_by_step=less))
        assert verdict.outcome == "REJECTED"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "more"),
    [
        (8083, pulsing(exact(8083), "navigation_lost")),  # pulses that cost next to nothing
        (9049, ("navigation.phases=[{from_s=1.0}]",)),  # estimates that are exact in every phase
    ],
)
def test_runs_are_verified_where_there_is_next_to_no_error(seed, more, tmp_path):
    scenario = exact(seed).with_assignments([*more, "recoverable.recourse=none", "simulation.runs=1"])
    assert verify(run(scenario, tmp_path / "run").path).outcome == "VERIFIED"
