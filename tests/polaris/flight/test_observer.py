"""The observer in flight code: estimates in Python, C and exact arithmetic, forgeries and closed loops."""

import math
import re
from dataclasses import replace

import flint
import numpy as np
import pytest
from scipy.linalg import expm

from polaris.certificate.checker import verify
from polaris.certificate.claims.coasting import exact_path
from polaris.certificate.code.answers import (
    CLIPPED,
    COMMAND,
    LATCHED,
    MISSED,
    PREDICTED,
    RANGE,
    REPEATED,
    STATE,
    FlightStep,
)
from polaris.certificate.code.check import check_code
from polaris.certificate.code.observer import OnBoard
from polaris.certificate.code.selftest import answered, selftest
from polaris.certificate.code.text import PRECISIONS, files, rounded
from polaris.certificate.files.document import read
from polaris.certificate.kernel.balls import PRECISION, column, matrix
from polaris.certificate.kernel.verdict import Record, Rejected
from polaris.certificate.model.plants import plant_of
from polaris.flight.export import export_c, flight_tables
from polaris.flight.observer import observer_rounding, with_observer
from polaris.flight.rounding import stated_rounding
from polaris.flight.vectors import calls
from polaris.model.errors import PolarisError, ScenarioError
from polaris.runs.case import replay, write_case
from polaris.runs.read_schedule import read_schedule
from polaris.runs.run import run
from polaris.scenario.scenario import load_scenario
from polaris.simulation.falsification.search import falsify
from polaris.simulation.on_board import FlightCode, code_of
from polaris.simulation.simulate import simulate
from tests.polaris.certificate.test_honest_sources import SOURCES
from tests.polaris.flight.evidence import (
    assert_every_branch_is_taken,
    assert_no_required_rule_is_broken,
    assert_no_run_time_error,
    assert_self_test_passes,
    assert_simple,
)
from tests.polaris.flight.library import FlightLibrary, copied, read_code
from tests.polaris.forging import COARSE, make
from tests.polaris.tiny import TINY
from tests.sizes import fewer


def declared(*names):
    return [text for name in names for text in SOURCES[name]]


SMOOTH = "feedback.period_s=0.25", "tracking.R=[60,60]", "system.disturbance_max=0.002", "simulation.runs=2"
SCENES = {
    "missed": [*SMOOTH, *declared("constant camera", "missed periods", "magnitude")],
    "late": [*SMOOTH, *declared("camera", "delay")],
    "late in a period": [*SMOOTH, *declared("constant camera"), "timing.delay_s=0.375"],
}
STEPS = {"missed": 1, "late": 1, "late in a period": 2}
"""Steps of a simulation per control period that make the delay a whole number of them."""
EACH = [(name, precision) for name in SCENES for precision in PRECISIONS]


@pytest.fixture(autouse=True)
def precise(monkeypatch):
    """As many bits as the checker begins with."""
    monkeypatch.setattr(flint.ctx, "prec", PRECISION)


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """Run folders, and the code of each with its observer in both precisions."""
    place = tmp_path_factory.mktemp("observer")
    for name in SCENES:
        (place / name).mkdir()
        run = make(SCENES[name], place / name)
        for precision in PRECISIONS:
            export_c(run, place / name / precision, precision, observer=True)
    return place


def document(folder, name):
    return read(folder / name / "run" / "certificate.json")


# -- evidence ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "precision"), EACH)
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_compilers_are_silent_and_the_self_test_passes(flown, tmp_path, compiler, name, precision):
    assert_self_test_passes(flown / name / precision, compiler, tmp_path / "test", "-O2")


@pytest.mark.parametrize(("name", "precision"), EACH)
def test_the_c_code_answers_as_python_to_the_last_bit(flown, tmp_path, name, precision):
    folder = flown / name / precision
    _, tables, _ = read_code(folder)
    library, count, outcomes = FlightLibrary(folder, tmp_path / "flight.so"), 0, set()
    for call, expected in answered(tables, precision, calls(tables, fewer(40_000, 300), 1)):
        if call.start:
            library.start()
        answer = library.step(call.period, call.state, call.controller, call.command, call.measured)
        assert (answer, str(answer.command)) == (expected, str(expected.command)), call  # -0.0 is not 0.0
        count += 1
        outcomes.add((answer.mode, answer.fault))
    assert count > 2000 and len(outcomes) > 20


def test_the_self_test_takes_every_branch(flown, tmp_path):
    assert_every_branch_is_taken(copied(flown / "missed" / "double", tmp_path / "code"))


def test_no_required_rule_of_misra_is_broken_and_functions_are_simple(flown, tmp_path):
    _, lines = assert_simple(flown / "late" / "float", tmp_path / "code.o", 500)
    assert lines <= 330
    assert_no_required_rule_is_broken(flown / "late" / "float")


@pytest.mark.parametrize(("name", "precision"), [("missed", "float"), ("late", "double")])
def test_no_input_makes_a_run_time_error(flown, tmp_path, name, precision):
    assert_no_run_time_error(flown / name / precision, tmp_path, "memory")


# -- answers ----------------------------------------------------------------------------------------


def test_measurements_that_are_missing_have_their_answer(flown):
    """As many in a row as declared are predicted over; one more, and S flies for good."""
    _, tables, _ = read_code(flown / "missed" / "double")
    x, m, none = tables.waypoints[0], len(tables.limit), (math.nan,) * len(tables.seen)
    u, y = (0.5,) * m, x[: len(tables.seen)]
    assert len(tables.updates) == 2 and tables.modes[0] == 1

    def fly(*measured, first=x):
        step = FlightStep(tables)
        return [step.step(node, first, 1, u, one).fault & ~CLIPPED for node, one in enumerate(measured)]

    assert fly(none, y, none, y, none, y) == [0, 0, PREDICTED, 0, PREDICTED, 0]
    for odd in (none, (y[0], math.inf), (-1.1e6, y[1])):
        assert fly(none, odd, odd, y) == [0, PREDICTED, STATE | LATCHED, LATCHED]
    assert fly(none, (9e5, y[1]), y)[1] & RANGE
    assert fly(y, y, first=(math.nan,) * len(x))[0] == STATE | LATCHED
    step = FlightStep(tables)
    step.step(0, x, 1, u, none)
    answer, repeated = (step.step(1, x, 1, u, y) for _ in range(2))
    assert repeated == replace(answer, fault=answer.fault | REPEATED)
    assert step.step(3, x, 1, u, y).fault & ~CLIPPED == MISSED | LATCHED
    step = FlightStep(tables)
    assert step.step(0, x, 0, u, none).fault == COMMAND | LATCHED


def test_an_estimate_that_runs_away_is_the_last_good_one(flown):
    _, tables, _ = read_code(flown / "late" / "double")
    step, far = FlightStep(tables), (9.9e5,) * len(tables.seen)
    step.step(0, tables.waypoints[0], 0, (0.0, 0.0), far)
    for node in range(1, 400):
        answer = step.step(node, (), 0, (0.0, 0.0), far if node % 2 else tuple(-y for y in far))
        assert all(math.isfinite(x) for x in (*step.state, *answer.command))


@pytest.mark.parametrize("name", SCENES)
def test_the_observer_estimates_as_the_declared_one(flown, name):
    """Predictions and updates of the theory, anew: states when they are measured, commands in between."""
    doc, (_, tables, _) = document(flown, name), read_code(flown / name / "double")
    A, B, M = (np.array(x) for x in (doc.A, doc.B, doc.observer["measures"]))
    h, delay, rng = doc.delta / doc.q, doc.timing.get("delay", 0.0), np.random.default_rng(0)
    gains = [np.array(x) for x in (doc.observer["gain"], *doc.observer.get("after", ()))]

    def flow(x, begin, end, flew):
        """Move under commands by period, from one instant to another."""
        while end - begin > 1e-12:
            k = math.floor(begin / h + 1e-9)
            until = min(end, (k + 1) * h)
            block = expm(np.block([[A, B], [np.zeros((len(B[0]), len(A) + len(B[0])))]]) * (until - begin))
            x = block[: len(A)] @ np.concatenate([x, flew.get(k, np.zeros(len(B[0])))])
            begin = until
        return x

    step, flew, unseen = FlightStep(tables), {}, 0
    start = np.array(tables.waypoints[0])
    estimate = expm(-A * delay) @ start  # nothing was commanded before
    for node in range(60):
        y = M @ start + rng.uniform(-0.05, 0.05, len(M))
        if node:
            estimate = flow(estimate, (node - 1) * h - delay, node * h - delay, flew)
            if name == "missed" and unseen == 0 and rng.random() < 0.5:
                y, unseen = y * math.nan, 1
            else:
                estimate, unseen = estimate + gains[unseen] @ (y - M @ estimate), 0
        answer = step.step(node, start.tolist(), 1, rng.uniform(-1, 1, 2).tolist(), y.tolist())
        flew[node] = np.array(answer.command)
        assert np.abs(step.state - flow(estimate, node * h - delay, node * h, flew)).max() <= 1e-11


# -- rounding ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "precision"), EACH)
def test_rounding_is_within_its_bound_and_the_bound_is_near(flown, name, precision):
    """Against the exact observer, which knows the exact law's commands, about the reference and far away."""
    doc, (_, tables, _) = document(flown, name), read_code(flown / name / precision)
    plant, rng, worst, q = plant_of(doc), np.random.default_rng(5), 0.0, doc.q
    path = exact_path(doc, plant, doc.states[doc.steps])
    exact = OnBoard(doc, plant, tables, precision)
    transition, force = (exact.exact()[key][0] for key in ("held", "force"))
    gain, limit = matrix(doc.laws[0].gain), list(map(flint.arb, doc.u_max))
    for flight in range(fewer(400, 60)):
        step, unseen, far = FlightStep(tables, precision), 0, flight % 10 > 0
        noise = 10 ** rng.uniform(-2, 0) if far else 0.01
        true = np.array(doc.center) + rng.uniform(-1, 1, len(doc.center)) * tables.range * 0.02
        true = rng.choice([-0.95, 0.95], len(true)) * tables.range if far else true
        z, x = column(true.tolist()), true.tolist()
        sent, flew = ([one] * len(tables.later) for one in (column([0.0] * 2), np.zeros(len(limit))))
        for node in range(doc.cells * q):
            true = (
                np.array(tables.held) @ true + np.array(tables.force) @ flew[0] if node and not far else true
            )
            y = np.array(tables.seen) @ true + rng.uniform(-1, 1, len(tables.seen)) * noise
            y = y - sum(np.array(M) @ u for M, u in zip(tables.later, flew, strict=True))
            missing = unseen < len(tables.updates) - 1 and rng.random() < 0.3
            if node:
                z = transition * z + force * sent[0]
                error = column(y.tolist()) - exact.output_map * z
                error = error + sum((M * u for M, u in zip(exact.later, sent, strict=True)), 0 * error)
                z, unseen = (z, unseen + 1) if missing else (z + exact.updates[unseen] * error, 0)
                z = column([one.mid() for one in z.entries()])  # balls would grow
            measured = (y * math.nan if missing and node else y).tolist()
            cell, place = divmod(node, q)
            mode = 0 if flight % 3 == 0 or cell >= doc.steps else doc.modes[cell]
            feed = column(doc.inputs[cell]) if cell < doc.steps else column([0.0] * len(limit))
            law = (feed + gain * (path.arcs[cell].nodes[place] - z)).entries()
            clipped = [min(max(u, -top), top) for u, top in zip(law, limit, strict=True)]
            commands = [float(u) * rng.uniform(0.9, 1) for u in clipped]  # U is as good
            answer = step.step(node, x, mode, commands, measured)
            if far and answer.fault & RANGE:
                break
            assert not answer.fault & RANGE
            pairs = zip(step.safety(cell, place, step.state), law, strict=True)  # not clipped
            worst = max(worst, *(float(abs(flint.arb(u) - v).upper()) for u, v in pairs))
            sent = [column(commands if answer.mode else clipped), *sent[:-1]]
            flew = [np.array(answer.command), *flew[:-1]]
    assert worst <= tables.rounding <= 125 * worst, tables.rounding / worst


@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_bound_on_rounding_that_does_not_hold_is_refused(flown, tmp_path, precision):
    honest, doc = copied(flown / "missed" / precision, tmp_path / "code"), document(flown, "missed")
    (header,) = honest.glob("*.h")
    text = header.read_text()
    (bound,) = re.findall(r"_ROUNDING \((\S+?)f?\)", text)
    for factor in (0.5, 1e3, 0.0, -1.0):
        forged = rounded(float.fromhex(bound) * factor, precision).hex()
        header.write_text(text.replace(bound, forged))
        with pytest.raises(Rejected, match="^rounding: commands|^rounding: .* is stated, twice"):
            check_code(doc, honest, Record())


@pytest.mark.parametrize(("gain", "own", "flow"), [(30.0, 1.0, 1.0), (1.0, 4.0, 1.0), (1e-6, 5e-4, 0.0)])
def test_errors_that_are_not_forgotten_are_refused_with_the_reason(flown, gain, own, flow):
    """Errors that grow beyond floating point, or take longer to fade than the checker follows them."""
    doc = document(flown, "late")
    doc.A = (flow * np.array(doc.A)).tolist()
    doc.laws[0] = replace(doc.laws[0], gain=(gain * np.array(doc.laws[0].gain)).tolist())
    doc.observer["gain"] = (own * np.array(doc.observer["gain"] if flow else np.eye(4))).tolist()
    tables = with_observer(flight_tables(doc), doc)
    with pytest.raises(ScenarioError, match="rounding is not forgotten by its estimates"):
        observer_rounding(doc, tables, "double", stated_rounding(doc, tables, "double"))


# -- the checker ------------------------------------------------------------------------------------


def forgeries(folder):
    """(label, file, text): one number of a table of the observer, one line, one macro at a time."""
    prefix, *_ = read_code(folder)
    header, source = folder / f"{prefix}.h", folder / f"{prefix}.c"
    text = source.read_text()
    for name in ("held", "force", "seen", "later", "updates", "heard", "waypoints"):
        begin = text.index(f" {name}[")
        end = text.index("};", begin)
        numbers = [one for one in re.finditer(r"-?0x1\.[0-9a-f]+p[+-]\d+", text) if begin < one.start() < end]
        by = 1 + (1e-4 if "f," in text[begin:end] else 1e-9)
        for one in numbers and {numbers[0], numbers[-1]}:
            for factor in (by, -1.0):
                forged = rounded(float.fromhex(one[0]) * factor, folder.name).hex()
                yield f"{name} times {factor}", source.name, text[: one.start()] + forged + text[one.end() :]
    for old, new in [
        ("off[o] = measured[o]", "off[o] = 0"),
        ("off[o] -= seen", "off[o] += seen"),
        ("updates[memory->unseen]", "updates[0]"),
        ("memory->unseen++", "memory->unseen = 0"),
        ("memory->answer.command[l];\n    }\n    for", "0;\n    }\n    for"),
        ("memory->state[j] = waypoints[0][j]", "memory->state[j] = waypoints[1][j]"),
        ("next[j] = input->state[j]", "next[j] = waypoints[0][j]"),
        ("(memory->newest + i) %", "(memory->newest) %"),
        ("if (memory->last < 0)", "if (memory->last < 9)"),
    ]:
        assert old in text, old
        yield old, source.name, text.replace(old, new, 1)
    macros = header.read_text()
    for old, new in [(r"_UPDATES \((\d+)\)", r"_UPDATES (1\1)"), (r"_PREDICTED 0x400U", "_PREDICTED 0x0U")]:
        yield old, header.name, re.sub(old, new, macros, count=1)


@pytest.mark.parametrize(("name", "precision"), EACH)
def test_an_altered_file_is_refused(flown, tmp_path, name, precision):
    honest, doc, count = copied(flown / name / precision, tmp_path / precision), document(flown, name), 0
    for label, file, text in forgeries(honest):
        before = (honest / file).read_text()
        assert text != before, label
        (honest / file).write_text(text)
        with pytest.raises(Rejected) as refused:
            check_code(doc, honest, Record())
        assert refused.value.claim == "code", label
        (honest / file).write_text(before)
        count += 1
    trusted = check_code(doc, honest, Record())
    assert count >= 30 and "measurement that the scenario declares, its first estimate" in trusted[0]


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        (lambda t: {"updates": t.updates[:1]}, "updates is not of the size"),
        (lambda t: {"updates": t.updates[::-1]}, "updates, node 0"),
        (lambda t: {"seen": [[1.001 * x for x in row] for row in t.seen]}, "seen, node 0"),
        (lambda t: {"later": [*t.later, t.later[0]]}, "later is not of the size"),
        (lambda t: {"held": t.loop or [[2 * x for x in row] for row in t.held]}, "held, node 0"),
        (lambda t: {"force": [[0 * x for x in row] for row in t.force]}, "force, node 0"),
        (lambda t: {"heard": [2 * x for x in t.heard]}, "heard"),
    ],
)
def test_code_that_agrees_with_itself_alone_is_refused(flown, tmp_path, change, rule):
    """Tables of other numbers or sizes, from which text and self-test are made as ours are."""
    doc = document(flown, "missed")
    honest = with_observer(flight_tables(doc), doc)
    forged = replace(honest, **change(honest))
    for name, text in files(forged, "forged", "double", doc.digest).items():
        (tmp_path / name).write_text(text)
    (tmp_path / "forged_selftest.c").write_text(selftest(forged, "forged", "double", calls(forged, 30, 0)))
    with pytest.raises(Rejected, match=f"^code: {rule}"):
        check_code(doc, tmp_path, Record())


@pytest.mark.parametrize(("off", "count"), [(8e-10, 2), (-8e-10, 2), (0.0, 2), (8e-9, 3)])
def test_a_delay_that_counts_as_whole_periods_has_the_same_tables_in_the_checker(flown, off, count):
    """Period or delay is a decimal that was cut off, such as of a third of a second."""
    doc = document(flown, "late")
    doc.timing["delay"] = 2 * doc.delta / doc.q * (1 + off)
    tables = with_observer(flight_tables(doc), doc)
    later = OnBoard(doc, plant_of(doc), tables, "double").later
    assert len(tables.later) == len(later) == count
    for table, exact in zip(map(matrix, tables.later), later, strict=True):
        assert all(abs(x) < 1e-14 for x in (table - exact).entries())


def test_verify_confirms_the_code_with_the_run(flown):
    verdict = verify(flown / "late" / "run", flown / "late" / "float")
    assert verdict.outcome == "VERIFIED" and "rounding" in dict(verdict.checked), verdict.text()


def test_an_observer_where_there_is_none_is_refused(flown, tmp_path):
    run, doc = make([COARSE], tmp_path), document(flown, "late")
    with pytest.raises(ScenarioError, match=r"without \[navigation.measurement\]"):
        export_c(run, tmp_path / "code", observer=True)
    for more in ({"monitor": True}, {"glue": "cfs"}):
        with pytest.raises(ScenarioError, match="must be off beside monitor and glue"):
            export_c(flown / "late" / "run", tmp_path / "code", observer=True, **more)
    doc.transients = [{"name": "navigation_lost", "lasts": 1.0}]
    with pytest.raises(ScenarioError, match="must be off where navigation may be lost"):
        with_observer(flight_tables(doc), doc)
    with pytest.raises(Rejected, match="where navigation is not lost"):
        check_code(doc, flown / "late" / "double", Record())
    doc.transients, doc.observer = [], None
    with pytest.raises(Rejected, match="states no observer"):
        check_code(doc, flown / "late" / "double", Record())
    doc = document(flown, "late")
    doc.timing["delay"] = 33.0
    with pytest.raises(ScenarioError, match="must be at most 32 periods"):
        with_observer(flight_tables(doc), doc)
    with pytest.raises(ScenarioError, match="has an observer, and the scenario has none"):
        FlightCode(flown / "late" / "double").require_schedule(read_schedule(run))


# -- closed loop ------------------------------------------------------------------------------------


def answers(code):
    """Faults that the code answered with while S and U flew, clipped commands of U apart."""
    return {(mode > 0, fault & ~CLIPPED if mode else fault) for mode, fault in code.answers}


@pytest.mark.parametrize(("name", "precision"), EACH)
def test_simulations_fly_the_observer_in_the_code(flown, name, precision):
    """As the Python loop flies in double; safe, as proven, in both."""
    schedule, code = read_schedule(flown / name / "run"), FlightCode(flown / name / precision)
    runs = simulate(schedule, 40, 4, tail=True, substeps=STEPS[name], code=code)
    faults = {0, PREDICTED} if name == "missed" else {0}
    assert answers(code) == {(by_u, fault) for by_u in (False, True) for fault in faults}
    assert not runs.metrics().collided.any()
    deviation = np.abs(runs.states - simulate(schedule, 40, 4, tail=True, substeps=STEPS[name]).states).max()
    assert deviation <= (1e-12 if precision == "double" else 1e-4)
    if STEPS[name] == 1:
        assert falsify(schedule, 60, 3, code=code).failure is None
    else:
        with pytest.raises(ScenarioError, match="must be of whole steps"):
            falsify(schedule, 60, 3, code=code)


def test_attacks_find_an_observer_that_is_not_the_proof_s(flown, tmp_path):
    """Measurements that count three times: the estimate is made of noise."""
    schedule, code = read_schedule(flown / "missed" / "run"), FlightCode(flown / "missed" / "double")
    observer = schedule.safety.tracking.system.observer
    wild = replace(observer, gain=3 * observer.gain, after=tuple(3 * gain for gain in observer.after))
    tracking = schedule.safety.tracking
    system = replace(tracking.system, observer=wild)
    safety = replace(schedule.safety, tracking=replace(tracking, system=system))
    forged = code_of(replace(schedule, safety=safety), observer=True)
    assert falsify(schedule, 400, 0, code=code).failure is None
    attack = falsify(schedule, 2000, 0, code=forged)
    case = write_case(tmp_path / "wild.case.json", load_scenario(TINY, SCENES["missed"]), attack)
    assert attack.failure is not None and replay(case, forged)[0] == attack.failure
    assert replay(case, code)[0] is None
    forged.start(1)
    with pytest.raises(ScenarioError, match="needs measurements"):
        forged.step(1, np.zeros((1, 4)), 0, np.zeros((1, 2)))


@pytest.mark.slow
@pytest.mark.parametrize("precision", PRECISIONS)
def test_thousands_of_attacks_on_the_code_violate_nothing(flown, precision):
    for name in ("missed", "late"):
        schedule, code = read_schedule(flown / name / "run"), FlightCode(flown / name / precision)
        attacks = falsify(schedule, fewer(20_000, 1000), 7, code=code)
        assert attacks.failure is None and attacks.runs >= 1000, f"{name}: {attacks.failure}"
        assert not any(fault & CLIPPED for mode, fault in code.answers if not mode)


@pytest.mark.slow
def test_code_of_random_scenes_with_observers_is_confirmed_and_flies_safely(tmp_path):
    """Whatever else is declared; each code is made, checked, and flown."""
    rng, proved = np.random.default_rng(4), 0
    others = sorted(set(SOURCES) - {"estimate", "phases", "camera", "constant camera", "outage"})
    for seed in range(fewer(100, 12)):
        camera = str(rng.choice(["camera", "constant camera"]))
        names = [camera, *rng.choice(others, rng.integers(0, 3), replace=False)]
        period, weight = rng.choice([0.25, 0.5]), float(rng.choice([20, 60]))
        options = f"feedback.period_s={period}", f"tracking.R={[weight] * 2}", "system.disturbance_max=0.004"
        place = tmp_path / str(seed)
        try:
            path = run(TINY, place / "run", overrides=["simulation.runs=2", *options, *declared(*names)]).path
            schedule = read_schedule(path)
            export_c(path, place / "code", observer=True)
        except PolarisError:
            continue
        check_code(read(path / "certificate.json"), place / "code", Record())
        code = FlightCode(place / "code")
        steps = 25 if "part of a period" in names else 1
        runs = simulate(schedule, 40, seed, tail=True, substeps=steps, code=code)
        assert not runs.metrics().collided.any(), names
        assert not any(fault & CLIPPED for mode, fault in code.answers if not mode), names
        proved += 1
    assert proved >= 5


@pytest.mark.parametrize("name", SCENES)
def test_estimates_that_are_handed_in_are_trusted_to_count_exact_commands(flown, tmp_path, name):
    """Find the assumption where code takes the estimate, and not where it has the observer."""
    export_c(flown / name / "run", tmp_path / "code")
    for code, expected in ((tmp_path / "code", True), (flown / name / "double", False)):
        trusted = check_code(document(flown, name), code, Record())
        assert any("told S's commands" in one for one in trusted) is expected
