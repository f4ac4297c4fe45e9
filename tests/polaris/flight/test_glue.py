"""Glue of flight code: compiled against stubs of F' and cFS, called, and answering as the Python step."""

import subprocess
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from polaris.certificate.checker import verify
from polaris.certificate.code.answers import COMMAND, LATCHED, Call, FlightStep
from polaris.certificate.code.text import KEY, PRECISIONS
from polaris.cli.app import app
from polaris.flight.export import export_c
from polaris.flight.glue import FILES, default_name, glue_files
from polaris.flight.vectors import calls
from polaris.model.errors import ScenarioError
from tests.polaris.flight.library import FLAGS, read_code, tool
from tests.polaris.forging import COARSE, make

STUBS = Path(__file__).parent / "stubs"
CPP = "-std=c++14 -pedantic -Wall -Wextra -Wconversion -Wshadow -Wdouble-promotion -Werror -ffp-contract=off"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return make([COARSE], tmp_path_factory.mktemp("glue"))


def stub(folder, name, target, values):
    """Write a stub with names in it."""
    (folder / target).write_text(KEY.sub(lambda key: values[key[1]], (STUBS / name).read_text()))


def compiled(command):
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", ""), done.stderr[:3000]


def names(folder, name, module="Components"):
    prefix, tables, precision = read_code(folder)
    values = {"PREFIX": prefix, "NAME": name, "APP": name.upper(), "MODULE": module}
    values |= {"N": str(len(tables.range)), "M": str(len(tables.limit))}
    return prefix, values | {"REAL": "F64" if precision == "double" else "F32"}


def component(folder, name, scratch, module="Components", compiler="g++"):
    """Compile an F' component against the stub of its base class."""
    prefix, values = names(folder, name, module)
    stub(scratch, "component_base.hpp", f"{name}ComponentAc.hpp", values)
    stub(scratch, "component_main.cpp", "main.cpp", values)
    compiled([tool("gcc"), *FLAGS, "-c", folder / f"{prefix}.c", "-o", scratch / "code.o"])
    place = [f"-I{one}" for one in (scratch, folder, folder / name)]
    sources = folder / name / f"{name}.cpp", scratch / "main.cpp", scratch / "code.o"
    compiled([tool(compiler), *CPP.split(), *place, *sources, "-o", scratch / "flown"])
    return scratch / "flown"


def application(folder, name, scratch, compiler="gcc"):
    """Compile a cFS application and its table against a stub of cFE."""
    prefix, values = names(folder, name)
    for header in ("cfe.h", "cfe_tbl_filedef.h"):
        stub(scratch, header, header, values)
    stub(scratch, "app_main.c", "main.c", values)
    place = [f"-I{one}" for one in (scratch, folder, folder / name / "fsw" / "src")]
    parts = folder / name / "fsw"
    sources = parts / "src" / f"{name}_app.c", parts / "tables" / f"{name}_tbl.c", scratch / "main.c"
    compiled([tool(compiler), *FLAGS, *place, *sources, folder / f"{prefix}.c", "-o", scratch / "flown"])
    return scratch / "flown"


def asked(calls):
    """Calls as the mains read them."""
    rows = ([call.period, call.controller, *map(float.hex, (*call.state, *call.command))] for call in calls)
    return "".join(" ".join(map(str, row)) + "\n" for row in rows)


def flight(tables):
    """Calls of one flight: regular ones until the schedule ends, hostile ones after it."""
    q, half = len(tables.moved), tuple(limit / 2 for limit in tables.limit)
    regular = [
        Call(False, period, tuple(tables.waypoints[period // q]), mode, half)
        for period, mode in enumerate(np.repeat(tables.modes, q).tolist())
    ]
    return [*regular, *calls(tables, 30, 3)]


def answers(lines):
    """(period, mode, fault, numbers) of every line."""
    for line in lines:
        period, mode, fault, *values = line.split()
        yield int(period), int(mode), int(fault), tuple(map(float.fromhex, values))


def as_the_step(tables, precision, calls, lines, allowed=True):
    step = FlightStep(tables, precision)
    for call, (period, mode, fault, values) in zip(calls, answers(lines), strict=True):
        answer = step.step(call.period, call.state, call.controller * allowed, call.command)
        expected = (*answer.command, answer.margin)
        assert (period, mode, fault, values) == (call.period, answer.mode, answer.fault, expected)


@pytest.mark.parametrize("compiler", ["g++", "clang++"])
@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_component_answers_as_the_code(run, tmp_path, precision, compiler):
    folder = tmp_path / "code"
    export_c(run, folder, precision, glue="fprime", name="Guard", module="Rendezvous")
    assert verify(run, folder).outcome == "VERIFIED"  # beside the code nothing is read
    program = component(folder, "Guard", tmp_path, "Rendezvous", compiler)
    _, tables, _ = read_code(folder)
    calls = flight(tables)
    UNINIT, VALID, INVALID, DEFAULT = range(4)
    for allow, valid, interval in (
        (1, VALID, 1),
        (0, DEFAULT, 7),
        (1, INVALID, 0),
        (1, UNINIT, 1),
        (1, DEFAULT, 2),
    ):
        missing = valid in (UNINIT, INVALID)  # before parameters are loaded, the value is anything
        options = [program, *map(str, (allow, valid, 1, interval))]
        done = subprocess.run(options, input=asked(calls), capture_output=True, text=True, check=True)
        *lines, summary = done.stdout.splitlines()
        as_the_step(tables, precision, calls, lines, bool(allow and not missing))
        verdicts, written, faults, modes = map(int, summary.split())
        assert (verdicts, written) == (len(calls), -(-len(calls) // max(interval, 1)))
        assert faults > 0 and (modes > 0) == bool(allow and not missing)
    silent = subprocess.run(
        [program, "1", str(DEFAULT), "0", "1"], input=asked(calls), capture_output=True, text=True
    )
    assert silent.stdout.splitlines()[-1].startswith("0 ")


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize("precision", PRECISIONS)
def test_an_application_answers_as_the_code(run, tmp_path, precision, compiler):
    folder = tmp_path / "code"
    export_c(run, folder, precision, prefix="demo", glue="cfs")
    assert verify(run, folder).outcome == "VERIFIED"
    program = application(folder, "demo_rta", tmp_path, compiler)
    _, tables, _ = read_code(folder)
    calls = flight(tables)
    valid = [call for call in calls if call.period not in (-7, -8)]
    odd = f"-7 0 {'0 ' * len(tables.range + tables.limit)}\n-8 0 {'0 ' * len(tables.range + tables.limit)}\n"
    done = subprocess.run([program], input=asked(valid) + odd * 2, capture_output=True, text=True, check=True)
    *lines, one, two, summary = done.stdout.splitlines()
    as_the_step(tables, precision, valid, lines)
    assert [line.split()[:3] for line in (one, two)] == [["hk", str(len(valid)), str(i)] for i in (0, 1)]
    loaded, subscribed, events, status = map(int, summary.split())
    assert (loaded, subscribed, status) == (1, 2, 3) and events == 0b1101110


def test_without_its_own_table_the_safety_controller_flies(run, tmp_path):
    export_c(run, tmp_path / "code", glue="cfs", name="guard")
    (table,) = (tmp_path / "code" / "guard" / "fsw" / "tables").glob("*.c")
    text = table.read_text()
    _, tables, precision = read_code(tmp_path / "code")
    calls = [call for call in flight(tables) if call.period not in (-7, -8)]
    other = text.replace("POLARIS_TINY_CERTIFICATE", '"' + "0" * 64 + '"')
    for place, forged in enumerate((other, text.replace(", 1}", ", 0}"), text.replace(", 1}", ", 2}"))):
        assert forged != text
        table.write_text(forged)
        scratch = tmp_path / str(place)
        scratch.mkdir()
        program = application(tmp_path / "code", "guard", scratch)
        done = subprocess.run([program], input=asked(calls), capture_output=True, text=True, check=True)
        *lines, summary = done.stdout.splitlines()
        as_the_step(tables, precision, calls, lines, allowed=False)
        assert summary.split()[0] == str(int(place == 1))
        assert {mode for _, mode, *_ in answers(lines)} == {0}
        assert any(fault & COMMAND and fault & LATCHED for _, _, fault, _ in answers(lines))


def test_the_model_of_a_component_is_fpp(run, tmp_path):
    """For its own checker, where that is installed: its syntax."""
    export_c(run, tmp_path / "code", glue="fprime")
    (model,) = (tmp_path / "code").rglob("*.fpp")
    compiled([tool("fpp-syntax"), model])


@pytest.mark.parametrize("framework", FILES)
def test_glue_may_call_the_online_monitor(run, tmp_path, framework):
    export_c(run, tmp_path / "code", prefix="demo")
    _, tables, precision = read_code(tmp_path / "code")
    plain, online = (
        "".join(glue_files(tables, "demo", precision, framework, online=monitor).values())
        for monitor in (False, True)
    )
    assert "demo_online" not in plain and "demo_memory" not in online
    for call in ("start", "step"):
        assert plain.replace(f"demo_{call}(", f"demo_online_{call}(").count(call) == online.count(call)
        assert f"demo_online_{call}(" in online and f"demo_{call}(" not in online


@pytest.mark.parametrize(
    ("given", "rule"),
    [
        ({"glue": "ros"}, "must be one of fprime, cfs"),
        ({"glue": "fprime", "name": "1a"}, "a letter first"),
        ({"glue": "fprime", "module": "a.b"}, "a letter first"),
        ({"glue": "fprime", "name": "a" * 17}, "at most 16"),
        ({"glue": "cfs", "name": "a" * 12}, "at most 11"),
        ({"glue": "cfs", "prefix": "demo", "name": "demo"}, "must not be the prefix"),
    ],
)
def test_names_that_make_no_glue_are_refused(run, tmp_path, given, rule):
    with pytest.raises(ScenarioError, match=rule):
        export_c(run, tmp_path / "code", **given)
    assert not (tmp_path / "code").exists()


def test_the_verb_writes_glue_and_replaces_it(run, tmp_path):
    out = tmp_path / "code"
    command = ["export", "c", str(run), "--out", str(out), "--glue"]
    done = CliRunner().invoke(app, [*command, "cfs", "--name", "guard"])
    assert done.exit_code == 0 and str(out / "guard" / "fsw" / "src" / "guard_app.c") in done.stdout
    done = CliRunner().invoke(app, [*command, "fprime"])
    assert done.exit_code == 0 and not (out / "guard").exists()
    assert default_name("polaris_static", "fprime") == "PolarisStatic"
    assert default_name("polaris_static", "cfs") == "static_rta"
    assert default_name("polaris_random_scene", "cfs") == "random_rta"
    assert (out / default_name("polaris_tiny", "fprime")).is_dir()
