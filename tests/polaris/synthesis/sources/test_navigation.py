"""Navigation by phase (Proposition 4), and an observer on board: bounds, sets, certificates and flights."""

import json
from copy import copy

import numpy as np
import pytest
from scipy.linalg import expm

from polaris.certificate.checker import verify, verify_document
from polaris.certificate.files.document import Document
from polaris.certificate.kernel.verdict import Rejected
from polaris.certificate.model.navigation import measured_errors
from polaris.model.errors import PolarisError, ScenarioError, SynthesisInfeasible
from polaris.model.scene.keep_in import KeepInPolytope
from polaris.runs.certificate import certificate
from polaris.runs.run import run
from polaris.scenario.reading import write_toml
from polaris.scenario.scenario import load_scenario
from polaris.simulation.delayed import Predicting
from polaris.simulation.disturbances import adjoint_worst_case, limit_rows
from polaris.simulation.falsification.search import falsify
from polaris.simulation.simulate import flown_modes, simulate
from polaris.synthesis.safety.get_safety import get_safety
from polaris.synthesis.schedule.synthesize import synthesize
from tests.kept import kept
from tests.polaris.closed_loops import attack, attack_monitor
from tests.polaris.forging import CERTIFICATE, Forger, Lie, make
from tests.polaris.model.test_timing import fly_delayed
from tests.polaris.synthesis.safety.test_closed_loops import judge, monitored
from tests.polaris.synthesis.sources.test_error_sources import exact
from tests.polaris.synthesis.sources.test_transients import pulsing
from tests.polaris.tiny import TINY, synthesised
from tests.sizes import fewer

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
EXACT = MEASURED[0], "navigation.measurement.error=[1e-300, 1e-300]"
SMALL = "navigation.measurement.error=[0.002, 0.002]"
RANGED = (
    "navigation.state_error=[0.01, 0.01, 0.004, 0.004]",
    "navigation.phases=[{from_s=0.5, within_m=[9.0, 7.0], state_error=[0.004, 0.004, 0.002, 0.002]},"
    " {from_s=8.5, within_m=[8.2, 6.2], state_error=[0.002, 0.002, 0.001, 0.001]}]",
)
LATE = ("timing.delay_s=0.3", "thrusters.magnitude_error=0.01")


def scene(*assignments):
    return load_scenario(TINY).with_assignments([*SAMPLED, *assignments])


def observed(name, *more):
    """The tiny scene with an observer."""
    return kept(f"observed-{name}", lambda: synthesize(scene(*MEASURED, *more)))


@pytest.mark.parametrize("name", ["tiny", "static"])
def test_bounds_of_an_observer_are_what_its_worst_noise_and_pushes_reach(name):
    """Period by period, the worst of all that comes for one state: the bound is little above it."""
    hill = ("feedback.period_s=2.0", "navigation.measurement.position_error_m=0.1")
    scenario = scene(*MEASURED) if name == "tiny" else load_scenario("static").with_assignments(hill)
    system, h, parts = scenario.system(), scenario.problem().period, 10
    observer, n = system.observer, system.n
    left, reached = np.eye(n), np.zeros(n)
    step, small = expm(system.A * h), expm(system.A * h / parts)
    for _ in range(600):
        back = left @ observer.rest @ expm(system.A * h / parts / 2)
        for _ in range(parts if np.abs(left).max() > 1e-9 else 0):
            reached += np.linalg.norm(back @ system.D, axis=1) * system.w_max * h / parts
            back = back @ small
        reached += np.abs(left @ observer.gain) @ observer.noise
        left = left @ observer.rest @ step
    assert np.all(reached <= system.navigation * (1 + 1e-6))
    assert np.all(reached >= 0.98 * system.navigation)


@pytest.mark.parametrize(
    ("name", "more", "substeps"),
    [("plain", (), 1), *(pytest.param("late", LATE, q, marks=pytest.mark.slow) for q in (1, 4))],
)
def test_observers_flown_for_real_stay_within_their_bounds_and_use_them(name, more, substeps):
    schedule = observed(name, *more)
    runs, off = fly_delayed(schedule, 60, 1, substeps)
    assert np.all(off <= 1) and off.max() > 0.75 and not runs.metrics().collided.any()
    assert falsify(schedule, 50, 1).failure is None
    still = simulate(schedule, 3, initial="center", disturbance="none")
    assert np.ptp(still.states, axis=0).max() == 0 and not still.metrics().collided.any()


def test_errors_of_a_phase_count_in_its_steps_alone():
    plain, phased = scene(PHASED[0]), scene(*PHASED)
    system, steps = phased.system(), phased.system().error_by_step
    assert steps.shape == (13, 4) and steps[:, 0].tolist() == [0.01] * 3 + [0.002] * 5 + [0.006] * 5
    assert np.array_equal(system.navigation, plain.system().navigation)
    assert np.array_equal(system.at_step(99).navigation, steps[-1])
    late = scene(*PHASED, "timing.delay_s=0.5").system().error_by_step
    assert np.all(late >= steps) and np.all(late[3] >= late[0] - 1e-12) and np.all(late[4] < late[0])
    one, two = (kept(f"phased-{i}", lambda s=s: synthesize(s)) for i, s in enumerate((plain, phased)))
    assert two.share(1) >= one.share(1)
    assert two.safety.tracking.disturbance(two.safety.tracking.gain)[-1].max() < (
        one.safety.tracking.disturbance(one.safety.tracking.gain)[-1].max()
    )
    judge(0, attack(two, 40, 0))
    assert falsify(two, 100, 0).failure is None
    wrong = np.repeat(20 * steps.max(axis=0)[None], 13, axis=0)
    object.__setattr__(two.safety.problem.system, "error_by_step", wrong)
    assert attack(two, 40, 0).over > 1e-3  # the attack would find errors that are left out
    object.__setattr__(two.safety.problem.system, "error_by_step", steps)


@pytest.mark.parametrize(
    "more",
    [
        pytest.param((FIRST, "thrusters.pulse='centred'", "timing.delay_s=0.3"), marks=pytest.mark.slow),
        ("thrusters={impulse_bit_N_s=0.001,remainder='carried'}",),
    ],
)
def test_observers_go_with_pulses_and_what_is_carried(more):
    schedule = observed("-".join(more), *more)
    system, alone = schedule.safety.problem.system, scene(*MEASURED, *more[2:]).system()
    assert np.all(system.navigation > alone.navigation)
    assert verify_document(certificate(schedule, "tiny")).outcome == "VERIFIED"
    assert np.all(fly_delayed(schedule, 50, 1)[1] <= 1 + 1e-6)
    assert falsify(schedule, 100, 1).failure is None


def test_first_errors_of_an_observer_fade_as_its_loop_says():
    schedule, plain = observed("first", FIRST), scene(*MEASURED).system()
    system, h = schedule.safety.problem.system, 0.25
    loop, first = system.observer.rest @ expm(system.A * h), system.observer.initial
    left = np.array([np.abs(np.linalg.matrix_power(loop, k)) @ first for k in range(200)])
    expected = [left[4 * k : 4 * k + 4].max(axis=0) for k in range(12)] + [left[48:].max(axis=0)]
    assert np.allclose(system.error_by_step, plain.navigation + expected, rtol=1e-6)
    _, off = fly_delayed(schedule, 60, 1, 1)
    assert np.all(off <= 1) and off.max() > 0.75
    zero = scene(*MEASURED, FIRST.replace("0.03", "0").replace("0.01", "0")).system()
    assert zero.observer.initial is None and np.array_equal(zero.navigation, plain.navigation)


def test_a_camera_knows_the_velocity_once_s_has_settled():
    """It measures the position within 10 cm: errors of thrusters count at what is commanded."""
    errors = ("thrusters.magnitude_error=0.05", "thrusters.misalignment_deg=2", "thrusters.mass_error=0.03")
    given = ["feedback.period_s=2.0", "navigation.measurement.position_error_m=0.1", "timing.delay_s=2"]
    safety = get_safety(load_scenario("static").with_assignments([*given, *errors]).problem())
    tracking = safety.tracking
    known = tracking.settled_tightening(tracking.estimate_error_rows) + tracking.unremembered(
        tracking.system.u_max
    )
    assert known[:3].max() < 0.19 and 0.008 < known[3:].max() < 0.0086
    assert tracking.system.navigation[3:].max() > 10 * known[3:].max()  # at full thrust


def test_estimates_of_an_observer_are_within_what_is_told():
    schedule = observed("told", "timing.delay_s=0.3", "thrusters.magnitude_error=0.05")
    estimate, full = schedule.estimate, schedule.safety.problem.system.navigation
    assert np.all(np.array(estimate["settled"]) < 0.6 * full)
    assert np.allclose(estimate["experimental"], 1.02 * full)  # the whole of the thrust may be in use
    assert observed("").estimate["settled"] is not None and synthesised()[1].estimate is None


@pytest.mark.parametrize("more", [(), ("timing.delay_s=0.5",)])
def test_an_observer_is_attacked_by_its_noise(more):
    """The falsifier flies the filter, within its bounds, and no other noise goes further."""
    schedule, rng = observed("-".join(["noise", *more]), FIRST, *more), np.random.default_rng(0)
    modes, rows, runs = flown_modes(schedule, False), limit_rows(schedule), 30
    flight = Predicting(schedule, modes, 1)
    rows, targets = rows[rng.integers(0, len(rows), runs)], rng.integers(5, flight.steps + 1, runs)
    w, _, _ = adjoint_worst_case(flight, rows, targets)
    x0 = np.repeat(schedule.safety.problem.initial_set.c[None], runs, axis=0)
    flown = flight.run(x0, w)
    assert np.all(flight.off <= 1 + 1e-9) and flight.off.max() > 0.5

    def far(states):
        return np.einsum("rn,rn->r", rows, states[np.arange(runs), targets])

    for _ in range(3):
        other = w.copy()
        noise = other[..., flight.columns[1]]
        other[..., flight.columns[1]] = noise * rng.choice([-1.0, 1.0], (*noise.shape[:2], 1))
        more_far = far(flight.run(x0, other).states) - far(flown.states)
        assert more_far.max() < 0.02 and more_far.mean() < -0.005  # some commands clip, and some are early


def test_bounds_hold_within_a_range_that_is_kept():
    schedule = kept("ranged", lambda: synthesize(scene(*RANGED)))
    known = schedule.safety.problem.system.error_by_step
    assert known[:, 0].tolist() == [0.01] + [0.004] * 8 + [0.002] * 4
    runs = simulate(schedule, 60, 1)
    assert not runs.metrics().collided.any() and falsify(schedule, 100, 1).failure is None
    p, late = np.abs(runs.states[..., :2]), runs.times >= 8.0
    assert np.all(p[:, late] < [8.2, 6.2]) and np.all(p[:, runs.times >= 0.0] < [9.0, 7.0])
    ranges = {item.name: item for item in schedule.safety.clearance.unsafe if item.name.startswith("within")}
    assert len(ranges) == 8 and ranges["within-1[0]"].offsets[7, 1, 0] == pytest.approx(-8200)
    assert ranges["within-1[0]"].offsets[8, 0, 0] == pytest.approx(-8.2) and ranges["within-1[3]"].static
    box, system = np.vstack([np.eye(2), -np.eye(2)]), scene().system()
    for begins, ends, static in (
        (3.0, np.inf, True),
        (3.0, 5.0, True),
        (12.0, np.inf, False),
        (0.0, 20.0, False),
    ):
        late = KeepInPolytope("late", box, np.ones(4), begins, ends)
        assert late.timed_polytopes(system, 1.0, 12)[0].static == static  # or nothing is claimed for ever
    with pytest.raises(SynthesisInfeasible, match="margins required from the unsafe sets"):
        synthesize(scene(RANGED[0], RANGED[1].replace("[8.2, 6.2]", "7.0")))


@pytest.mark.slow
@pytest.mark.parametrize("made", ["pulse='centred'", "impulse_bit_N_s=0.001,remainder='carried'"])
def test_phases_go_with_pulses_and_what_is_carried(made):
    """Measurements err within the bounds of the steps that use them, and predictions within theirs."""
    late = (f"thrusters={{magnitude_error=0.01,{made}}}", "timing.delay_s=0.25", "timing.missed_periods=1")
    schedule = kept(f"phased-{made}", lambda: synthesize(scene(*PHASED, *late)))
    known, timing = schedule.safety.problem.system.error_by_step, schedule.safety.problem.system.timing
    assert len(np.unique(known, axis=0)) >= 3 and (timing.pulse_thrust or timing.carried_impulse)
    plain = scene(*PHASED, "thrusters.magnitude_error=0.01", *late[1:]).system().error_by_step
    assert np.all(known > plain)
    assert verify_document(certificate(schedule, "tiny")).outcome == "VERIFIED"
    assert falsify(schedule, 100, 1).failure is None
    assert np.all(fly_delayed(schedule, 50, 1)[1] <= 1 + 1e-6)


def test_without_phases_everything_is_as_it_was():
    plain, none = scene(PHASED[0]), scene(PHASED[0], "navigation.phases=[]")
    assert none.system().error_by_step is None and none.system().observer is None
    assert certificate(synthesize(plain), "tiny") == certificate(synthesize(none), "tiny")


@pytest.mark.parametrize(
    ("assignments", "field"),
    [
        ((*MEASURED, PHASED[0]), "navigation.measurement"),
        ((MEASURED[0],), "navigation.measurement.error"),
        ((MEASURED[0], "navigation.measurement.error=[0.1]"), "navigation.measurement.error"),
        ((*MEASURED, "timing.missed_periods=21"), "timing.missed_periods"),
        ((*EXACT, "system.disturbance_max=0.0"), "navigation.measurement"),
        (("navigation.measurement.position_error_m=0.1",), "navigation.measurement.position_error_m"),
        (("navigation.measurement.matrix=[[0,0,1,0]]", "navigation.measurement.error=[0.1]"), "navigation"),
        (("navigation.measurement.matrix=[[1,0]]", "navigation.measurement.error=[0.1]"), "navigation"),
        (("navigation.phases=[{from_s=3.0},{from_s=3.0}]",), "navigation.phases"),
        (("navigation.phases=[{from_s=3.0,position_error_m=1.0}]",), "navigation.phases[0].position_error_m"),
        (
            (*MEASURED, "navigation.measurement.initial={position_error_m=1.0}"),
            "navigation.measurement.initial",
        ),
        (("navigation.phases=[{from_s=12.0,within_m=9.0}]",), "navigation.phases[0].from_s"),
        (("navigation.phases=[{from_s=3.0,within_m=[9.0]}]",), "navigation.phases[0].within_m"),
        (("navigation.phases=[{from_s=3.0,within_m=9.0}]", "abort={drift_s=3.0}"), "abort.keep_in"),
        (
            (*MEASURED, "faults=[{kind='loss',share=0.1,isolation_s=1.0}]", "timing.missed_periods=1"),
            "faults",
        ),
    ],
)
def test_bad_tables_are_refused_by_name(assignments, field):
    with pytest.raises(ScenarioError) as error:
        scene(*assignments)
    assert error.value.field.startswith(field)


MISSED = "timing.missed_periods=2"
NEAR = "navigation.measurement.initial={state_error=[0.006, 0.006, 0.003, 0.003]}"


@pytest.mark.parametrize("first", [pytest.param(None, marks=pytest.mark.slow), FIRST])
def test_bounds_hold_for_every_pattern_of_missed_periods_and_some_reach_them(first):
    """The worst that any pattern of measurements can reach, worked out for many of them."""
    scenario, rng, share = scene(*MEASURED, MISSED, *filter(None, [first])), np.random.default_rng(1), 0.0
    system, h, parts = scenario.system(), 0.25, 40
    observer, bound = system.observer, np.array(system.timing.measured_error)
    small, moved = expm(system.A * h / parts), expm(system.A * h / parts / 2) @ system.D
    for likely in np.linspace(0, 1, 60):
        left, reached, age = np.eye(system.n), np.zeros(system.n), rng.integers(0, 8 if first else 40)
        while age > 0:
            j = 0 if rng.random() < likely else int(rng.integers(1, 3))
            reached += np.abs(left @ (observer.gain, *observer.after)[j]) @ observer.noise
            left, age = left @ observer.rests[j], age - j - 1
            for _ in range(parts * (j + 1)):
                reached += np.linalg.norm(left @ moved, axis=1) * system.w_max * h / parts
                left = left @ small
        reached += np.abs(left) @ observer.initial if first else 0.0
        share = np.maximum(share, reached / bound)
    assert np.all(share <= 1 + 1e-6) and share.max() > 0.9


def test_missed_periods_cost_what_the_theory_says():
    measured = "navigation.measurement.position_error_m=0.1"
    given = ["feedback.period_s=2.0", measured]
    static, ratios = load_scenario("static").with_assignments(given), []
    for missed in (1, 3):
        system = static.with_assignments([f"timing.missed_periods={missed}"]).system()
        ratios.append(np.max(np.array(system.timing.measured_error) / static.system().navigation))
    assert np.round(ratios, 2).tolist() == [1.04, 1.11]


LED = SMALL, "thrusters.pulse='start'", "thrusters.magnitude_error=0.01", "feedback.period_s=0.1"


@pytest.mark.parametrize("more", [(), (SMALL, "timing.delay_s=0.3", "thrusters.pulse='centred'", NEAR), LED])
def test_observers_go_with_missed_periods(more):
    schedule = observed("-".join(["missed", *more]), MISSED, *more)
    assert verify_document(certificate(schedule, "tiny")).outcome == "VERIFIED"
    off = fly_delayed(schedule, 60, 1, 1)[1]
    assert np.all(off <= 1) and off.max() > (0.3 if more else 0.7)
    assert falsify(schedule, 60, 1).failure is None


FORGED = SMALL, FIRST, "thrusters.pulse='centred'", "timing.delay_s=0.25"


AGED = SMALL, MISSED, "thrusters.magnitude_error=0.02"


@pytest.mark.parametrize(
    "more", [(), FORGED, AGED, pytest.param((SMALL, MISSED, NEAR), marks=pytest.mark.slow)]
)
def test_forged_observers_are_refused(more, tmp_path):
    """Neither another gain, nor less noise, nor smaller bounds than they give."""
    forger = Forger(make([*SAMPLED[:2], *MEASURED, *more], tmp_path), tmp_path)
    assert forger.judge({}).outcome == "VERIFIED"
    data = forger.tree(CERTIFICATE)["system"]

    def judged(observer=(), **system):
        changed = data | system | {"observer": data["observer"] | dict(observer)}
        return forger.judge({CERTIFICATE: json.dumps(forger.honest | {"system": changed})})

    half = [[(float.fromhex(x) / 2).hex() for x in row] for row in data["observer"]["gain"]]
    less = {"estimate_error": [(float.fromhex(x) * 0.999).hex() for x in data["estimate_error"]]}
    if by_step := data.get("error_by_step"):
        less["error_by_step"] = [[(float.fromhex(x) * 0.999).hex() for x in row] for row in by_step]
    if MISSED in more:
        after = [
            [[(float.fromhex(x) / 2).hex() for x in row] for row in M] for M in data["observer"]["after"]
        ]
        measured = [(float.fromhex(x) * 0.99).hex() for x in data["timing"]["measured_error"]]
        for verdict in (
            judged({"after": after}),
            judged(timing=data["timing"] | {"measured_error": measured}),
        ):
            assert (verdict.outcome, verdict.claim) == ("REJECTED", "system")
        assert judged({"after": after[:1]}).outcome == "REJECTED"
        if "by_age" in data["observer"]:
            smaller = [
                [[(float.fromhex(x) * 0.99).hex() for x in row] for row in M]
                for M in data["observer"]["by_age"]
            ]
            first, later = (
                [smaller[0], *data["observer"]["by_age"][1:]],
                [data["observer"]["by_age"][0], *smaller[1:]],
            )
            sooner = [age - 1 if age else 0 for age in data["observer"]["ages"]]
            for change in ({"by_age": first}, {"by_age": later}, {"ages": sooner}, {"followed": 0}):
                assert judged(change).outcome == "REJECTED", change
    elif more:
        for key in ("settled", "initial"):
            smaller = [(float.fromhex(x) * 0.99).hex() for x in data["observer"][key]]
            assert judged({key: smaller}).outcome == "REJECTED"
    for verdict in (judged({"gain": half}), judged(**less)):
        assert (verdict.outcome, verdict.claim) == ("REJECTED", "system")
    assert judged({"noise": [(0.001).hex()] * 2}).outcome == "REJECTED"
    if more != FORGED:  # errors that are stated twice: nothing would verify these
        lie = Lie(forger)
        lie.certificate["system"]["observer"]["settled"] = [(0.0).hex()] * 4
        lie.judge({"system"})
    for when in ("settled", "experimental"):  # what the run says that they may be off by
        lie, changed = Lie(forger), forger.tree("schedule.json")["guarantee"]["estimate"]
        changed |= {when: [0.9 * x for x in changed[when]]}
        lie.schedule["guarantee"]["estimate"] = lie.summary["guarantee"]["estimate"] = changed
        lie.judge({"goal"})
    document, honest = Document(forger.honest), forger.tree("scenario.toml")
    by_step = FIRST in more or NEAR in more
    assert len(measured_errors(document, honest)) == (13 if by_step else 1)
    forged = copy(document)
    forged.transients = [{"name": "stuck_on", "pushes": [[1.0, 0.0]]}]
    with pytest.raises(Rejected, match="late thruster faults are not covered"):
        measured_errors(forged, honest | {"timing": {"missed_periods": 1}})
    scenario = forger.tree("scenario.toml")
    scenario["navigation"]["measurement"]["error"] = [0.0051, 0.005]
    assert forger.judge({"scenario.toml": write_toml(scenario)}).outcome == "REJECTED"


def test_forged_ranges_are_refused(tmp_path):
    """The certificate keeps every box of the scenario, no larger, for as long as its phase lasts."""
    forger = Forger(make([*SAMPLED[:2], *RANGED], tmp_path), tmp_path)
    assert forger.judge({}).outcome == "VERIFIED"
    for text in (
        {"within_m": [8.1, 6.2]},
        {"within_m": [8.2]},
        {"from_s": 6.5},
        {"from_s": 12.0},
        {"state_error": [0.003, 0.002, 0.001, 0.001]},
    ):
        scenario = forger.tree("scenario.toml")
        scenario["navigation"]["phases"][1] |= text
        assert forger.judge({"scenario.toml": write_toml(scenario)}).outcome == "REJECTED", text
    without = forger.tree("scenario.toml")
    del without["navigation"]["phases"][1]["within_m"]
    assert forger.judge({"scenario.toml": write_toml(without)}).outcome == "REJECTED"


@pytest.mark.slow
def test_forged_phases_are_refused(tmp_path):
    forger = Forger(make([*SAMPLED[:2], *PHASED, "timing.delay_s=0.25"], tmp_path), tmp_path)
    assert forger.judge({}).outcome == "VERIFIED"
    data = forger.tree(CERTIFICATE)["system"]
    for step in (3, 12):
        less = [list(row) for row in data["error_by_step"]]
        less[step] = [(float.fromhex(x) * 0.999).hex() for x in less[step]]
        lie = data | {"error_by_step": less}
        assert forger.judge({CERTIFICATE: json.dumps(forger.honest | {"system": lie})}).outcome == "REJECTED"
    for phase, key, value in ((0, "from_s", 4.5), (1, "state_error", [0.007, 0.0, 0.003, 0.003])):
        scenario = forger.tree("scenario.toml")
        scenario["navigation"]["phases"][phase][key] = value
        assert forger.judge({"scenario.toml": write_toml(scenario)}).outcome == "REJECTED"


@pytest.mark.slow
def test_proofs_of_random_scenes_hold_with_observers_and_phases():
    scenes, seeds = 0, range(5000, fewer(5080, 5030))
    for seed in seeds:
        scenario = exact(seed)
        problem, rng = scenario.problem(), np.random.default_rng(seed)
        hill, widths = problem.system.mean_motion is not None, problem.initial_set.half_widths / 20
        T, n = problem.K * problem.delta, problem.system.n
        if problem.period and seed % 4:
            key = "position_error_m" if hill else "error"
            more = [f"navigation.measurement.{key}={(widths[: n // 2] + 1e-9).tolist()}"]
            rows = [] if hill else [f"navigation.measurement.matrix={np.eye(n)[: n // 2].tolist()}"]
            more += [*rows, f"timing.delay_s={problem.period}", "thrusters.mass_error=0.01"]
            if seed % 8 > 2 and not hill:
                more.append(f"navigation.measurement.initial.state_error={(3 * widths).tolist()}")
            more += ["thrusters.pulse='centred'"] if seed % 4 == 1 else []
            more += [f"timing.missed_periods={seed % 3}"] if seed % 5 < 2 else []
            bit = 0.01 * problem.period * problem.system.u_max.min()
            more += (
                [f"thrusters.impulse_bit_N_s={bit}", "thrusters.remainder='carried'"] if seed % 4 == 2 else []
            )
        else:
            keys = ("position_error_m", "velocity_error_m_s") if hill else ("state_error",)
            parts = [np.split(widths * size, len(keys)) for size in rng.uniform(0, 1.5, 3)]
            texts = [",".join(f"{k}={v.tolist()}" for k, v in zip(keys, part, strict=True)) for part in parts]
            more = [f"navigation.{k}={v.tolist()}" for k, v in zip(keys, parts[0], strict=True)]
            far = 2 * np.abs(problem.system.position @ problem.initial_set.c).max()
            ranged = [f"within_m={far}," if seed % 3 and far else "", ""]
            later = zip((0.37, 0.8), ranged, texts[1:], strict=True)
            later = [f"{{from_s={at * T},{within}{each}}}" for at, within, each in later]
            more.append(f"navigation.phases=[{','.join(later)}]")
        try:
            schedule = synthesize(scenario.with_assignments(more))
        except PolarisError:
            continue
        scenes += 1
        judge(seed, attack(schedule, 100, seed))
        assert falsify(schedule, 100, seed).failure is None
        if scenes % 10 == 1 and (monitor := monitored(seed, schedule)) is not None:
            judge(seed, attack_monitor(monitor, 30, seed)[0])
        if schedule.safety.problem.system.observer is not None:
            assert np.all(fly_delayed(schedule, 20, seed)[1] <= 1 + 1e-6), seed
    assert scenes >= len(seeds) / 3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "more"),
    [
        (7002, ("timing.delay_s=0.05",)),  # a state that nothing disturbs
        (8083, pulsing(exact(8083), "navigation_lost")),  # pulses that cost next to nothing
        (9049, ("navigation.phases=[{from_s=1.0}]",)),  # estimates that are exact in every phase
        (
            9060,
            ("navigation={position_error_m=3e-9,phases=[{from_s=600.0,position_error_m=[1e-9,3e-9,1e-9]}]}",),
        ),
    ],
)
def test_runs_are_verified_where_there_is_next_to_no_error(seed, more, tmp_path):
    scenario = exact(seed).with_assignments([*more, "recoverable.recourse=none", "simulation.runs=1"])
    assert verify(run(scenario, tmp_path / "run").path).outcome == "VERIFIED"
