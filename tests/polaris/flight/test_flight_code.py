"""Flight code of a run: compilers are silent, C answers as Python to the last bit, forgeries are refused."""

import copy
import math
import os
import re
import subprocess
from dataclasses import replace
from pathlib import Path

import flint
import numpy as np
import pytest
from typer.testing import CliRunner

from polaris.certificate.checker import verify
from polaris.certificate.claims.coasting import exact_path
from polaris.certificate.code import check
from polaris.certificate.code.answers import (
    CLIPPED,
    CLOCK,
    COMMAND,
    ENDED,
    LATCHED,
    MISSED,
    RANGE,
    REPEATED,
    STATE,
    FlightStep,
)
from polaris.certificate.code.check import check_code, precisions
from polaris.certificate.code.selftest import answered, selftest
from polaris.certificate.code.text import PRECISIONS, files, rounded
from polaris.certificate.files.document import read
from polaris.certificate.kernel.balls import PRECISION, column, matrix
from polaris.certificate.kernel.verdict import Record, Rejected
from polaris.certificate.model.plants import plant_of
from polaris.cli.app import app
from polaris.flight.export import default_prefix, export_c, flight_tables
from polaris.flight.rounding import as_disturbance
from polaris.flight.vectors import calls
from polaris.model.errors import ScenarioError
from polaris.rta.decision_grid import DecisionGrid
from polaris.runs.read_schedule import read_schedule
from polaris.runs.run import run
from tests.polaris.flight.evidence import (
    assert_every_branch_is_taken,
    assert_no_required_rule_is_broken,
    assert_self_test_passes,
    assert_simple,
    source_of,
)
from tests.polaris.flight.library import FlightLibrary, built, copied, read_code, sources, tool
from tests.polaris.forging import COARSE, make
from tests.polaris.random_scenarios import random_scenario

FLIGHTS = 80_000 if os.environ.get("POLARIS_CAMPAIGN") else 300


@pytest.fixture(autouse=True)
def precise(monkeypatch):
    """As many bits as the checker begins with."""
    monkeypatch.setattr(flint.ctx, "prec", PRECISION)


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """A run folder, and the code of it in both precisions."""
    place = tmp_path_factory.mktemp("flight")
    run = make([COARSE], place)
    for precision in PRECISIONS:
        export_c(run, place / precision, precision)
    return place


@pytest.fixture(scope="module")
def document(flown):
    return read(flown / "run" / "certificate.json")


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_compilers_are_silent_and_the_self_test_passes(flown, tmp_path, compiler, precision):
    for level in ("-O0", "-O2"):
        assert_self_test_passes(flown / precision, compiler, tmp_path / f"test{level}", level)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("machine", ["arm-linux-gnueabihf", "aarch64-linux-gnu"])
def test_other_machines_give_the_same_bits(flown, tmp_path, machine, precision):
    """32 and 64 bits of ARM, emulated; the self-test compares to the last bit, in single precision too."""
    emulator, flags = [tool(f"qemu-{machine.split('-')[0]}")], ("-O2", "-static")
    out = tmp_path / "test"
    assert_self_test_passes(flown / precision, f"{machine}-gcc", out, *flags, emulator=emulator)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_the_c_code_answers_as_python_to_the_last_bit(flown, tmp_path, precision):
    _, tables, _ = read_code(flown / precision)
    library, count, outcomes = FlightLibrary(flown / precision, tmp_path / "flight.so"), 0, set()
    for call, expected in answered(tables, precision, calls(tables, FLIGHTS, 1)):
        if call.start:
            library.start()
        answer = library.step(call.period, call.state, call.controller, call.command)
        assert (answer, str(answer.command)) == (expected, str(expected.command)), call  # -0.0 is not 0.0
        count += 1
        outcomes.add((answer.mode, answer.fault))
    assert count > 8 * FLIGHTS and len(outcomes) > 20


@pytest.mark.parametrize("precision", PRECISIONS)
def test_the_self_test_takes_every_branch(flown, tmp_path, precision):
    assert_every_branch_is_taken(copied(flown / precision, tmp_path / "code"))


def test_no_required_rule_of_misra_is_broken(flown):
    assert_no_required_rule_is_broken(flown / "float")


def test_functions_are_simple_and_the_stack_is_small(flown, tmp_path):
    _, tables, _ = read_code(flown / "double")
    n, m = len(tables.gain[0]), len(tables.limit)
    functions, _ = assert_simple(flown / "double", tmp_path / "code.o", 400)
    text = source_of(flown / "double").read_text()
    assert functions == 8 and f"at most {n * n + 2 * n * m} products" in text


def test_a_call_that_differs_in_the_last_bit_is_found(flown):
    """The comparison of the self-test can fail: one unit in the last place of one expected number."""
    prefix, *_ = read_code(flown / "double")
    text = (flown / "double" / f"{prefix}_selftest.c").read_text()
    margins = re.findall(r"\}, (0x1\.[0-9a-f]{12})([0-8])(p-\d+)\}\}", text)
    before = "".join(margins[0])
    after = f"{margins[0][0]}{int(margins[0][1]) + 1}{margins[0][2]}"
    altered = flown / "altered"
    altered.mkdir()
    for path in (flown / "double").glob("*.[ch]"):
        (altered / path.name).write_text(path.read_text())
    (altered / f"{prefix}_selftest.c").write_text(text.replace(before, after, 1))
    program = built(altered, "gcc", sources(altered), altered / "test")
    done = subprocess.run([program], capture_output=True, text=True)
    assert done.returncode == 1 and done.stdout.count("differs") == 1


def test_regular_flights_answer_as_the_simulation(flown):
    """S's command at every node along all references, and U's within the limits, up to rounding."""
    schedule, rng = read_schedule(flown / "run"), np.random.default_rng(3)
    grid, (_, tables, _) = DecisionGrid.from_schedule(schedule), read_code(flown / "double")
    last = len(tables.waypoints) * len(tables.moved)
    for alone in (True, False):
        step, errors = FlightStep(tables), []
        for node in range(last):
            x = grid.xi[node] + rng.uniform(-0.1, 0.1, grid.system.n)
            u = rng.uniform(-2, 2, grid.system.m)
            k = node // grid.clearance.q
            mode = int(schedule.modes[k]) if k < len(schedule.modes) else 0
            answer = step.step(node, x, 0 if alone else mode, u)
            by_u = mode > 0 and not alone
            assert answer.mode == mode * by_u
            limit = grid.system.u_max
            expected = np.clip(u, -limit, limit) if by_u else grid.clipped(0, node, x)
            errors.append(np.abs(np.array(answer.command) - expected).max())
            assert answer.margin == pytest.approx(1 - np.max(np.abs(expected) / limit), abs=1e-12)
        assert max(errors) <= 1e-13


def test_each_fault_has_its_answer(flown):
    _, tables, _ = read_code(flown / "double")
    first, n, m = tables.modes.index(1) * len(tables.moved), len(tables.gain[0]), len(tables.limit)
    x, u = tuple(tables.waypoints[first // len(tables.moved)]), (0.5,) * m

    def fly(*more, last=first):
        step = FlightStep(tables)
        for node in range(last):
            k = node // len(tables.moved)
            step.step(node, tables.waypoints[k], tables.modes[k], u)
        return [step.step(*call) for call in more]

    regular, repeated = fly((first, x, 1, u), (first, x, 0, (math.nan,) * m))
    assert (regular.mode, regular.fault, regular.command) == (1, 0, u) and repeated.fault == REPEATED
    for call, fault in [
        ((first, (math.nan, *x[1:]), 1, u), STATE),
        ((first, (-2e6, *x[1:]), 1, u), STATE),
        ((first, x, 0, u), COMMAND),
        ((first, x, 2, u), COMMAND),
        ((first, x, 1, (math.inf,) * m), COMMAND),
        ((first + 1, x, 1, u), MISSED),
        ((-1, x, 1, u), CLOCK),
    ]:
        answer, later = fly(call, (first + 1 + (fault == MISSED), x, 1, u))
        assert (answer.mode, answer.fault & ~CLIPPED) == (0, fault | LATCHED)
        assert later.mode == 0 and later.fault & LATCHED
    (clipped,) = fly((first, x, 1, (9.0,) * m))
    assert clipped.fault == CLIPPED and clipped.command == tuple(tables.limit) and clipped.margin == 0
    (late,) = fly((2**31 - 1, x, 1, u))
    assert late.fault & ENDED and late.fault & MISSED and late.mode == 0
    (distant,) = fly((first, (1e5,) * n, 1, u))
    assert distant.mode == 1 and distant.fault == RANGE


@pytest.mark.parametrize("number", [-1, -7, -(2**31)])
def test_a_number_of_a_period_that_is_none_moves_s_nowhere(flown, number):
    """S flies the period that comes next, as if it had been called for that one."""
    _, tables, _ = read_code(flown / "double")
    q, none = len(tables.moved), (0.0,) * len(tables.limit)
    for last in (0, 3 * q + 1, len(tables.modes) * q):
        answers = []
        for period in (last + 1, number):
            step = FlightStep(tables)
            for node in range(last + 1):
                step.step(node, tables.waypoints[node // q], 0, none)
            answers.append(step.step(period, tables.waypoints[(last + 1) // q], 0, none))
            assert step.last == last + 1
        assert answers[0].command == answers[1].command and answers[1].fault & CLOCK
    step.last = 2**31 - 1
    assert step.step(number, tables.waypoints[0], 0, none).fault & CLOCK and step.last == 2**31 - 1


# -- rounding ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("precision", PRECISIONS)
def test_rounding_is_within_its_bound_and_the_bound_is_near(flown, document, precision):
    """Against the exact law along the exact reference, in balls, inside and at the ends."""
    _, tables, _ = read_code(flown / precision)
    path = exact_path(document, plant_of(document), document.states[document.steps])
    step, rng, q, worst = FlightStep(tables, precision), np.random.default_rng(5), document.q, 0.0
    gain, reach = matrix(document.laws[0].gain), np.array(tables.range)
    for place in range(6000):
        cell, part = divmod(int(rng.integers(0, document.cells * q)), q)
        x = reach * (rng.choice([-1, 1], len(reach)) if place % 2 else rng.uniform(-1, 1, len(reach)))
        commands = step.safety(cell, part, [rounded(one, precision) for one in x.tolist()])
        feed = document.inputs[cell] if cell < document.steps else [0.0] * len(document.u_max)
        exact = column(feed) + gain * (path.arcs[cell].nodes[part] - column(x.tolist()))
        errors = (abs(flint.arb(u) - v) for u, v in zip(commands, exact.entries(), strict=True))
        worst = max(worst, *(float(one.upper()) for one in errors))
    assert worst <= tables.rounding <= 100 * worst


def test_the_checker_says_how_exact_code_will_be_without_code(flown, document):
    """From the certificate's numbers alone: nearly the bounds that both codes state, and what each takes."""
    statement = dict(verify(flown / "run").checked)["rounding"]
    for precision in PRECISIONS:
        error, share = re.search(rf"{precision} within (\S+) N, (\S+) of", statement).groups()
        _, tables, _ = read_code(flown / precision)
        assert float(error) == pytest.approx(tables.rounding, rel=0.5)
        assert float(share) == pytest.approx(as_disturbance(document, float(error)), rel=0.01)
    little = copy.copy(document)
    little.w_max = document.w_max * float(share) / 2
    assert [part.endswith("too much to fly") for part in precisions(little).split(";")] == [False, True]


@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_bound_on_rounding_that_does_not_hold_is_refused(flown, document, tmp_path, precision):
    honest = copied(flown / precision, tmp_path / "code")
    (header,) = honest.glob("*.h")
    text = header.read_text()
    (bound,) = re.findall(r"_ROUNDING \((\S+?)f?\)", text)
    for factor in (0.4, 2.5, 0.0, -1.0):
        forged = rounded(float.fromhex(bound) * factor, precision).hex()
        header.write_text(text.replace(bound, forged))
        with pytest.raises(Rejected, match="^rounding: commands|^rounding: .* is stated, twice"):
            check_code(document, honest, Record())
    header.write_text(text)
    with pytest.MonkeyPatch.context() as patch:  # a world that leaves nothing to take
        patch.setattr(document, "w_max", 0.3 * float.fromhex(bound))
        with pytest.raises(Rejected, match="of the disturbance bound"):
            check_code(document, honest, Record())
        assert as_disturbance(document, float.fromhex(bound)) > 1
        patch.setattr(document, "w_max", 0.0)
        assert "no disturbance bound covers that" in check_code(document, honest, Record())[1]
        assert as_disturbance(document, 1.0) == 0
        patch.setattr(document, "w_max", 0.02)
        patch.setattr(document, "D", [[1.0], [0.0], [0.0], [0.0]])
        assert "no disturbance bound covers that" in check_code(document, honest, Record())[1]
        assert as_disturbance(document, 1.0) == 0


# -- the checker ------------------------------------------------------------------------------------


def forgeries(folder):
    """(label, file, text): one number of a table, one line, one macro at a time."""
    prefix, tables, _ = read_code(folder)
    header, source = folder / f"{prefix}.h", folder / f"{prefix}.c"
    text = source.read_text()
    for name in ("waypoints", "feed", "moved", "pushed", "gain", "limit", "range"):
        begin = text.index(f" {name}[")
        end = text.index("};", begin)
        numbers = [one for one in re.finditer(r"-?0x1\.[0-9a-f]+p[+-]\d+", text) if begin < one.start() < end]
        by = 1 + (1e-4 if "f," in text[begin:end] else 1e-9)
        for one in (numbers[0], numbers[len(numbers) // 2], numbers[-1]):
            for factor in (by, -1.0):
                forged = rounded(float.fromhex(one[0]) * factor, folder.name).hex()
                label = f"{name} at {one.start()} times {factor}"
                yield label, source.name, text[: one.start()] + forged + text[one.end() :]
    modes = text.index("modes[")
    place = text.index("0U", modes)
    yield "a step more of U", source.name, text[:place] + "1U" + text[place + 2 :]
    place = text.index("1U", modes)
    yield "another controller", source.name, text[:place] + "2U" + text[place + 2 :]
    for old, new in [
        ("value > limit[i]", "value > 2 * limit[i]"),
        ("memory->latched = 1", "memory->latched = 0"),
        ("memory->latched != 0) ? 0", "memory->latched > 1) ? 0"),
        ("= reference - state[j]", "= state[j] - reference"),
        ("+= gain", "-= gain"),
        ("node % ", "0 * "),
        ("fault = " + prefix.upper() + "_STATE;", ";"),
        ("#include <float.h>", "#include <float.h>\n#define limit range"),
        ("};\n", "};\n\n"),
    ]:
        assert old in text, old
        yield old, source.name, text.replace(old, new, 1)
    macros = header.read_text()
    for old, new in [
        (r'CERTIFICATE "(.)', r'CERTIFICATE "f' if 'CERTIFICATE "f' not in macros else r'CERTIFICATE "0'),
        (r"_COVERED \((\d+)\)", r"_COVERED (1\1)"),
        (r"_PARTS \(\d+\)", "_PARTS (1)"),
        (r"_FARTHEST \(.*?\)", "_FARTHEST (0x1p+100)"),
        (r"_CLOCK 0x08U", "_CLOCK 0x00U"),
        (r"typedef (double|float)", "typedef long double"),
    ]:
        assert re.search(old, macros), old
        yield old, header.name, re.sub(old, new, macros, count=1)
    program = folder / f"{prefix}_selftest.c"
    tested = program.read_text()
    yield "a lenient self-test", program.name, tested.replace("wrong = 1;", "wrong = 0;")
    flipped = re.sub(r"\n \{(\d)", lambda one: f"\n {{{1 - int(one[1])}", tested, count=1)
    yield "another answer", program.name, flipped
    yield "no self-test", program.name, ""
    yield "another header", "float.h", ""


@pytest.mark.parametrize("precision", PRECISIONS)
def test_an_altered_file_is_refused(flown, document, tmp_path, precision):
    honest, count = copied(flown / precision, tmp_path / precision), 0
    record = Record()
    assert check_code(document, honest, record) and record.checked[0][0] == "code"
    for label, name, text in forgeries(honest):
        before = (honest / name).read_text() if (honest / name).exists() else None
        assert text != before, label
        (honest / name).write_text(text)
        with pytest.raises(Rejected) as refused:
            check_code(document, honest, Record())
        assert refused.value.claim == "code", label
        count += 1
        (honest / name).unlink() if before is None else (honest / name).write_text(before)
    assert count >= 30 and check_code(document, honest, Record())


@pytest.mark.parametrize(
    "name", ["evil.h.gch", "more.cc", "more.o", "more/more.c", "bits/types.h", "Guard/Other.hpp", "Makefile"]
)
def test_a_file_that_polaris_does_not_write_is_refused(flown, document, tmp_path, name):
    """A compiler, or a folder of headers, might take it for a part of the code."""
    honest = copied(flown / "double", tmp_path / "code")
    for allowed in (".polaris.jsonl", "Guard/Guard.hpp", "guard/fsw/src/guard_app.h"):
        (honest / allowed).parent.mkdir(parents=True, exist_ok=True)
        (honest / allowed).write_text("")
    assert check_code(document, honest, Record())
    (honest / name).parent.mkdir(exist_ok=True)
    (honest / name).write_text("")
    with pytest.raises(Rejected, match="^code: the folder holds '.*', which `polaris export c` does not"):
        check_code(document, honest, Record())


def test_a_precompiled_header_would_take_the_place_of_the_header(flown, document, tmp_path):
    """GCC reads it instead, whatever is in it."""
    honest = copied(flown / "double", tmp_path / "code")
    (header,) = honest.glob("*.h")
    evil = tmp_path / header.name
    evil.write_text(re.sub(r"_COVERED \((\d+)\)", r"_COVERED (1\1)", header.read_text()))
    built(tmp_path, "gcc", [evil.name], honest / f"{header.name}.gch", "-x", "c-header")
    with pytest.raises(Rejected, match="code: the folder holds"):
        check_code(document, honest, Record())


def test_states_that_the_code_would_take_for_errors_are_refused(flown, tmp_path, monkeypatch):
    """S would fly by an old estimate from the first call on."""
    (tmp_path / "scene.toml").write_text(random_scenario(0))  # 8,000 km away
    far = run(tmp_path / "scene.toml", tmp_path / "far", overrides=["simulation.runs=1"])
    with pytest.raises(ScenarioError, match=r"reference: got 8\d*\.\d*; must keep within 500000"):
        export_c(far.path, tmp_path / "code")
    _, tables, _ = read_code(flown / "double")
    monkeypatch.setattr(check, "FARTHEST", 1.01 * max(tables.range))
    verdict = verify(flown / "run", flown / "double")
    assert verdict.claim == "code" and "the code believes none beyond" in verdict.witness
    monkeypatch.setattr(check, "FARTHEST", 3 * max(tables.range))
    assert verify(flown / "run", flown / "double").outcome == "VERIFIED"


def test_a_self_test_that_tests_little_is_refused(flown, document, tmp_path):
    honest = copied(flown / "double", tmp_path / "code")
    prefix, tables, precision = read_code(honest)
    for flights in (0, 2):
        program = selftest(tables, prefix, precision, calls(tables, flights, 0))
        (honest / f"{prefix}_selftest.c").write_text(program)
        with pytest.raises(Rejected, match="the self-test makes .* calls, and must make at least 100"):
            check_code(document, honest, Record())


def test_a_number_that_the_compiler_rounds_is_refused(flown, document, tmp_path):
    """In single precision: what flies would be another number than the one that is checked."""
    honest = copied(flown / "float", tmp_path / "code")
    prefix, tables, precision = read_code(honest)
    maps = [[[x * (1 + 1e-9) for x in row] for row in part] for part in tables.moved]
    forged = replace(tables, moved=maps)
    for name, text in files(forged, prefix, precision, document.digest).items():
        (honest / name).write_text(text)
    program = selftest(forged, prefix, precision, calls(forged, 20, 0))
    (honest / f"{prefix}_selftest.c").write_text(program)
    with pytest.raises(Rejected, match="code: .* differs from the text of its numbers"):
        check_code(document, honest, Record())


@pytest.mark.parametrize(
    "change",
    [
        lambda t: {"moved": t.moved[:-1], "pushed": t.pushed[:-1]},
        lambda t: {"waypoints": t.waypoints[:-1]},
        lambda t: {"modes": [*t.modes, 0], "feed": [*t.feed, t.feed[0]]},
        lambda t: {"modes": [1 for _ in t.modes]},
        lambda t: {"covered": t.covered + 1},
        lambda t: {"limit": [2 * x for x in t.limit]},
        lambda t: {"gain": t.gain[::-1], "limit": t.limit[::-1]},
        lambda t: {"range": [x / 2 for x in t.range]},
    ],
)
def test_code_that_agrees_with_itself_alone_is_refused(document, tmp_path, change):
    """Tables of other numbers or sizes, from which text and self-test are made as ours are."""
    honest = flight_tables(document)
    forged = replace(honest, **change(honest))
    for name, text in files(forged, "forged", "double", document.digest).items():
        (tmp_path / name).write_text(text)
    program = selftest(forged, "forged", "double", calls(forged, 12, 0))
    (tmp_path / "forged_selftest.c").write_text(program)
    with pytest.raises(Rejected, match="^code: "):
        check_code(document, tmp_path, Record())


def test_code_belongs_to_a_leg_and_not_to_a_mission(tmp_path):
    (tmp_path / "certificate.json").write_text('{"format": "polaris-mission"}')
    verdict = verify(tmp_path, tmp_path)
    assert (verdict.outcome, verdict.claim) == ("REJECTED", "code")


@pytest.mark.parametrize("seed", [1, 2])
def test_code_of_random_scenes_is_confirmed(tmp_path, seed):
    (tmp_path / "scene.toml").write_text(random_scenario(seed))
    run_folder = run(tmp_path / "scene.toml", tmp_path / "run", overrides=["simulation.runs=2"])
    certificate, record = read(run_folder.path / "certificate.json"), Record()
    for precision in PRECISIONS:
        folder = tmp_path / precision
        export_c(run_folder.path, folder, precision)
        check_code(certificate, folder, record)
        program = built(folder, "gcc", sources(folder), tmp_path / f"{precision}-test")
        assert subprocess.run([program], capture_output=True).returncode == 0
    assert [claim for claim, _ in record.checked] == 2 * ["code", "rounding"]


def test_code_of_another_run_is_refused(flown, document, tmp_path):
    other = make([COARSE, "tracking.R=[61,61]"], tmp_path)
    export_c(other, tmp_path / "code")
    with pytest.raises(Rejected, match="another certificate"):
        check_code(document, tmp_path / "code", Record())


# -- the command line -------------------------------------------------------------------------------


def test_the_verbs_export_and_verify(flown, tmp_path):
    run, out = str(flown / "run"), tmp_path / "code"
    done = CliRunner().invoke(app, ["export", "c", run, "--out", str(out), "--prefix", "demo"])
    assert done.exit_code == 0, done.output
    assert [Path(line).name for line in done.stdout.split()] == ["demo.h", "demo.c", "demo_selftest.c"]
    done = CliRunner().invoke(app, ["export", "c", run, "--out", str(out), "--prefix", "demo"])
    assert done.exit_code == 0  # what Polaris wrote may be replaced
    done = CliRunner().invoke(app, ["verify", run, "--code", str(out)])
    assert done.exit_code == 0 and "demo: text, tables and self-test in double" in done.stdout
    plain, coded = verify(run), verify(run, out)
    claims = [dict(verdict.checked)["recoverable"] for verdict in (plain, coded)]
    counts = [int(re.findall(r"\d+", text)[0]) for text in claims]
    assert counts[1] > counts[0]  # S may take over at every node
    (out / "demo.c").write_text((out / "demo.c").read_text().replace("latched = 1", "latched = 0"))
    done = CliRunner().invoke(app, ["verify", run, "--code", str(out)])
    assert done.exit_code == 5 and "code: " in done.stdout
    done = CliRunner().invoke(app, ["export", "c", run, "--out", str(out)])
    assert done.exit_code == 2 and "was changed since Polaris wrote it" in done.stderr


@pytest.mark.parametrize(
    ("options", "rule"),
    [
        ({"precision": "half"}, "must be one of double, float"),
        ({"prefix": "1a"}, "a letter first"),
        ({"prefix": "a" * 21}, "at most 20"),
        ({"prefix": "stdint"}, "no header of C"),
    ],
)
def test_options_that_make_no_code_are_refused(flown, tmp_path, options, rule):
    with pytest.raises(ScenarioError, match=rule):
        export_c(flown / "run", tmp_path / "code", **options)
    assert not (tmp_path / "code").exists()


def test_what_is_not_proved_does_not_fly(document):
    assert default_prefix("Wild name-1 that is long") == "polaris_wild_name_1_"
    for change, rule in [
        ({"guarantee": "statistical"}, "must be 'proved'"),
        ({"u_max": [1.0, 0.0]}, "above 0"),
    ]:
        original = {key: getattr(document, key) for key in change}
        vars(document).update(change)
        with pytest.raises(ScenarioError, match=rule):
            flight_tables(document)
        vars(document).update(original)
