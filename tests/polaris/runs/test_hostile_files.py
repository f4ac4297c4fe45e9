"""Files that are none, never end, nest without end or hold more than they show; names that are commands."""

import json
import os
import resource
import shutil
import signal
import zipfile
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

pytest.importorskip("onnx")

from polaris.certificate.__main__ import main as check
from polaris.certificate.files.artefacts import read_scenario
from polaris.certificate.kernel.verdict import Rejected
from polaris.cli.app import app
from polaris.model.errors import PolarisError, ScenarioError, escape_controls
from polaris.model.files import MOST_DOTS, parse_json, parse_toml
from polaris.model.scene.obstacles import BallObstacle
from polaris.report import write_report
from polaris.rta.online.decision_log import read_log
from polaris.runs.campaign import formats as campaign_formats
from polaris.runs.campaign import make_cases
from polaris.runs.files import arrays
from polaris.runs.files.folder import read_json
from polaris.runs.files.tables import json_text
from polaris.scenario.reading import printable
from polaris.scenario.scenario import load_scenario
from polaris.traces import read_trace
from reach.networks.onnx_file import read_onnx
from reach.numerics.errors import ReachError
from tests.polaris.runs.campaign.scene import run as run_campaign
from tests.polaris.runs.test_user_files import make
from tests.polaris.tiny import TINY


def polaris(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


@contextmanager
def bounded(memory=2**30):
    """Fail instead of waiting or filling the memory for ever: a net, no measure."""

    def stop(number, frame):
        raise AssertionError("it waits")

    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + memory, before[1]))
    handler = signal.signal(signal.SIGALRM, stop)
    signal.alarm(120)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, handler)
        resource.setrlimit(resource.RLIMIT_AS, before)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A run folder and a campaign."""
    place = tmp_path_factory.mktemp("made")
    make(place / "run")
    run_campaign(make_cases([str(TINY)]), 2, place / "campaign", batch=2)
    return place


def device(path):
    path.symlink_to("/dev/zero")


def enormous(path):
    with path.open("wb") as file:
        file.truncate(2**41)  # no block of it is on the disk


KINDS = os.mkfifo, device, Path.mkdir, enormous


READERS = {
    "scenario": ("x.toml", load_scenario),
    "network": ("x.onnx", read_onnx),
    "case": ("x.json", lambda path: expect(polaris("replay", path))),
    "trace": ("x.json", read_trace),
    "evaluate": ("x.json", lambda path: expect(polaris("evaluate", path))),
    "log": ("x.jsonl", read_log),
    "JSON": ("x.json", read_json),
    "arrays": ("x.npz", arrays.read_arrays),
    "Parquet": ("x.parquet", campaign_formats.Parquet().check),
    "npz of a campaign": ("x.npz", campaign_formats.Npz().check),
}
"""Whatever reads a file, by itself."""


def expect(done, code=2):
    """A verb that ends with its message."""
    assert done.exit_code == code and done.stderr.startswith("error: ") and done.stderr.count("\n") == 1, (
        done.output
    )
    raise ScenarioError("verb", None, done.stderr)


@pytest.mark.skipif(not os.path.exists("/dev/zero"), reason="needs devices")
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("reader", READERS)
def test_what_is_no_file_is_refused(tmp_path, reader, kind):
    name, read = READERS[reader]
    kind(tmp_path / name)
    with bounded(), pytest.raises((ScenarioError, ReachError, OSError, ValueError)):
        read(tmp_path / name)


FILES = "scenario.toml", "schedule.json", "reference.csv", "trajectories.npz", "certificate.json"


@pytest.mark.skipif(not os.path.exists("/dev/zero"), reason="needs devices")
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", FILES)
def test_a_run_folder_with_such_a_file_is_refused(made, tmp_path, name, kind):
    run = shutil.copytree(made / "run", tmp_path / "run")
    (run / name).unlink()
    kind(run / name)
    verbs = ["plot", run, "-q"], ["report", run, "-q"], ["export", run, "x.json"], ["falsify", run]
    with bounded():
        for words in verbs:
            done = polaris(*words)
            assert done.exit_code == 2 and done.stderr.startswith("error: "), (words, done.output)
        assert polaris("verify", run).exit_code in (2, 5, 6)
        assert check([str(run)]) in (2, 5, 6)


@pytest.mark.parametrize("kind", KINDS)
def test_a_campaign_with_such_a_file_is_refused(made, tmp_path, kind):
    campaign = shutil.copytree(made / "campaign", tmp_path / "c")
    (part,) = (campaign / "runs").iterdir()
    for path in (part, campaign / "manifest.json"):
        path.unlink()
        kind(path)
        with bounded():
            done = polaris("campaign-replay", campaign, "--worst", "1")
        assert done.exit_code == 2 and done.stderr.startswith("error: "), done.output


DEEP = "[" * 100_000 + "]" * 100_000


def test_nested_json_anywhere_is_one_message(made, tmp_path):
    for name, text in {
        "trace.json": f'{{"agents": {DEEP}, "unsafe": {{}}}}',
        "case.json": '{"scenario": ' + DEEP + "}",
        "log.jsonl": DEEP + "\n",
    }.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    for read in (
        lambda: read_trace(tmp_path / "trace.json"),
        lambda: read_json(tmp_path / "log.jsonl"),
        lambda: read_log(tmp_path / "log.jsonl"),
        lambda: expect(polaris("replay", tmp_path / "case.json")),
        lambda: expect(polaris("evaluate", tmp_path / "trace.json")),
    ):
        with pytest.raises(PolarisError):
            read()
    with pytest.raises(ValueError, match="nested"):
        parse_json(DEEP)
    run = shutil.copytree(made / "run", tmp_path / "run")
    (run / "certificate.json").write_text(f'{{"artefacts": {DEEP}}}', encoding="utf-8")
    assert polaris("plot", run, "-q").exit_code == 2 and check([str(run)]) == 5


LONG = ".".join(["a"] * 240_001)
HIDDEN = [
    f"{LONG} = 1",
    f"[{LONG}]",
    f"x = {{ y = '''\n''', {LONG} = 1 }}",
    f'# it\'s """\n{LONG} = 1\n# """',
    f'"\\"".{LONG}."b" = 1',
    f'x = """a"""" # \\\n{LONG} = 1 # "',  # a text may end with quotes of its own
    f"x = ['''a'''', {{ {LONG} = '' }}]",
]


@pytest.mark.parametrize("text", HIDDEN, ids=range(len(HIDDEN)))
def test_a_key_of_many_parts_is_never_parsed(text, tmp_path, monkeypatch):
    dots = "." * 2000 + " a.b" * 100  # in comments and texts they do not count
    assert parse_toml(f'# {dots}\nx = \'{dots}\'\ny = """\n{dots}"""')["x"] == dots
    assert parse_toml(f'x = """{dots}"""""')["x"] == dots + '""'

    def parse(text):
        raise AssertionError("it takes the square of its length")

    monkeypatch.setattr("tomllib.loads", parse)
    (tmp_path / "scenario.toml").write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=f"more than {MOST_DOTS} dots"):
        parse_toml(text)
    with pytest.raises(ScenarioError, match="dots"):
        load_scenario(tmp_path / "scenario.toml")
    with pytest.raises(Rejected, match="dots"):
        read_scenario(tmp_path)


def test_arrays_are_measured_before_they_are_loaded(tmp_path, monkeypatch):
    np.savez_compressed(tmp_path / "x.npz", a=np.zeros(400_000), b=np.zeros(400_000))
    assert (tmp_path / "x.npz").stat().st_size < 20_000
    assert set(arrays.read_arrays(tmp_path / "x.npz")) == {"a", "b"}
    loaded = []
    monkeypatch.setattr(np, "load", lambda *args, **more: loaded.append(args))
    monkeypatch.setattr(arrays, "LARGEST", 5_000_000)
    with pytest.raises(ValueError, match="arrays take 64002"):
        arrays.read_arrays(tmp_path / "x.npz")
    assert loaded == []


@pytest.mark.parametrize("shape", [(2**40,), (3,), (2**20, 2**20, 2**20), (-8,)])
def test_a_shape_that_does_not_fit_is_refused(tmp_path, shape):
    with zipfile.ZipFile(tmp_path / "x.npz", "w") as archive, archive.open("a.npy", "w") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": shape})
        file.write(bytes(16))
    with bounded(), pytest.raises(ValueError, match="does not fit"):
        arrays.read_arrays(tmp_path / "x.npz")


def test_tables_are_measured_before_they_are_loaded(made, monkeypatch):
    (part,) = (made / "campaign" / "runs").iterdir()
    assert campaign_formats.Parquet().check(part)[1] == 2
    monkeypatch.setattr(campaign_formats, "open_regular", lambda path, limit: path.open("rb"))
    monkeypatch.setattr(campaign_formats, "LARGEST", 8)
    with pytest.raises(ValueError, match="its columns take more"):
        campaign_formats.Parquet().check(part)


NAME = "\x1b[31mred\x1b]0;title\x07\x9b2J\u202e\x00end"
SAFE = set("\n\t")


def obeyed(text):
    """Characters that a terminal or a browser would obey."""
    return {c for c in text if not c.isprintable() and c not in SAFE and not c.isspace()}


def test_no_command_survives():
    assert obeyed(NAME) and not obeyed(escape_controls(NAME))
    assert escape_controls("a\n\tb é ∞ 汉") == "a\n\tb é ∞ 汉"
    texts = [
        str(ScenarioError(f"agents.{NAME}", NAME, NAME, NAME)),
        str(PolarisError(NAME)),
        json_text({NAME: NAME}),
    ]
    assert not any(map(obeyed, texts)) and json.loads(texts[-1]) == {NAME: NAME}
    for string in ("\x1b[31m", printable("\x1b[31m"), escape_controls("\x1b[31m")):  # with one backslash
        assert str(ScenarioError("name", string, "is taken")) == r"name: got '\u001b[31m'; is taken"
    with pytest.raises(ScenarioError) as refused:
        BallObstacle("\x1b[31m", [0, 0], 1)
    assert not obeyed(str(refused.value))


def trace(**changed):
    agent = {"state_trace": [[0, 0, 0], [1, 1, 0]], "mode_trace": [1, 3]} | changed
    unsafe = {"set_type": "ball", "state_trace": [[0, [[5, 0], 1]]]}
    return json.dumps({"agents": {NAME: agent}, "unsafe": {NAME: unsafe}, NAME: 1})


@pytest.mark.parametrize("changed", [{}, {"state_trace": []}, {"mode_trace": [NAME, 1]}, {NAME: 1}])
@pytest.mark.parametrize("more", [[], ["--json"], ["--legacy"], ["--legacy", "--json"]])
def test_names_in_traces_reach_no_terminal(tmp_path, changed, more):
    (tmp_path / "t.json").write_text(trace(**changed), encoding="utf-8")
    done = polaris("evaluate", tmp_path / "t.json", *more)
    assert "red" in done.stdout + done.stderr
    assert not obeyed(done.stdout) and not obeyed(done.stderr)


def test_titles_of_scenarios_reach_neither_terminal_nor_page(made, tmp_path):
    lines = TINY.read_text(encoding="utf-8").splitlines()
    lines = [f"title = {json.dumps(NAME)}" if line.startswith("title") else line for line in lines]
    (tmp_path / "x.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    done = polaris(
        "run", tmp_path / "x.toml", "--out", tmp_path / "r", "--no-figures", "--set", "simulation.runs=1"
    )
    assert done.exit_code == 0 and not obeyed(done.stdout) and not obeyed(done.stderr)
    page = write_report(tmp_path / "r").read_text(encoding="utf-8")
    start = page.index("plotly.js v")
    assert "red" in page[:start] and not obeyed(page[:start]) and not obeyed(page[page.rindex("<script") :])
    done = polaris("verify", tmp_path / "r")
    assert not obeyed(done.stdout) and not obeyed(done.stderr)
    for words in (["check", tmp_path / f"{NAME[:-4]}.toml"], ["plot", tmp_path / "\x1b[2J"]):
        done = polaris(*words)
        assert done.exit_code == 2 and not obeyed(done.stderr)
        assert r"\u001b[" in done.stderr and "\\\\" not in done.stderr and r"\x1b" not in done.stderr
