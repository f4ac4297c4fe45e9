"""Folders that are written again: what is somebody else's stays, and nothing is ever half there."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from polaris.model.errors import ScenarioError
from polaris.report.figures import draw_run
from polaris.runs.files import atomic as replacing
from polaris.runs.files import ownership
from polaris.runs.files.atomic import CannotWrite, check_file, check_target
from polaris.runs.files.ownership import tidy
from polaris.runs.run import read_run
from polaris.runs.schedule import write_run
from tests.leftovers import left_by_a_dead_process
from tests.polaris.tiny import TINY, flown, synthesised

ROOT = Path(__file__).parents[3]


def contents(folder):
    """All files by name, with what they hold; links with where they point."""
    return {
        path.relative_to(folder).as_posix(): os.readlink(path) if path.is_symlink() else path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_symlink() or path.is_file()
    }


def write(target, files):
    """A folder of ours with these files."""
    with replacing.replacing(target) as beside:
        for name, text in files.items():
            (beside / name).parent.mkdir(parents=True, exist_ok=True)
            (beside / name).write_bytes(text)
    return target


# -- what is somebody else's --------------------------------------------------------------------------


def test_a_newer_run_replaces_what_polaris_wrote_and_nothing_else(tmp_path, monkeypatch):
    def draw(picture, folder, figures):
        paths = [folder / name for name in ("scene.pdf", "scene.png")]
        for path in paths:
            path.write_bytes(b"drawn")
        return paths

    monkeypatch.setattr("polaris.report.figures.draw_figures", draw)
    scenario, schedule = synthesised()
    target = tmp_path / "run"
    write_run(target, scenario, schedule, flown(), draw=draw_run)
    mine = {
        "notes.txt": b"mine",
        "figures/annotated.png": b"mine too",
        "archive/2024/scenario.toml": b"a copy",
        ".git/HEAD": b"ref",
    }
    for name, text in mine.items():
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        (target / name).write_bytes(text)
    (target / "empty").mkdir()
    with replacing.adding(target) as beside:
        (beside / "report.html").write_bytes(b"of the older run")
    other = scenario.with_assignments(["simulation.seed=5"])
    write_run(target, other, schedule, flown())
    files = contents(target)
    assert mine.items() <= files.items() and (target / "empty").is_dir()
    assert read_run(target).scenario.simulation.seed == 5
    # figures and report of the older run would belong to nothing any more
    assert [name for name in files if name.startswith("figures/")] == ["figures/annotated.png"]
    assert "report.html" not in files
    draw_run(read_run(target))
    assert (target / "figures" / "annotated.png").read_bytes() == b"mine too"
    assert (target / "figures" / "scene.pdf").read_bytes() == b"drawn"
    write_run(target, other, schedule, flown())
    assert [name for name in contents(target) if name.startswith("figures/")] == ["figures/annotated.png"]
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_a_copy_of_a_run_inside_a_run_is_somebody_elses(tmp_path):
    import shutil

    target = write(tmp_path / "run", {"summary.json": b"{}", "sets.npz": b"1"})
    shutil.copytree(target, target / "before")
    before = contents(target / "before")
    write(target, {"summary.json": b"{}", "sets.npz": b"2"})
    assert contents(target / "before") == before and (target / "sets.npz").read_bytes() == b"2"


def test_a_name_that_is_needed_keeps_the_file_that_had_it(tmp_path):
    target = write(tmp_path / "run", {"sets.npz": b"1"})
    (target / "figures").mkdir()
    (target / "figures" / "scene.png").write_bytes(b"drawn by hand")
    write(target, {"sets.npz": b"2", "figures/scene.png": b"ours"})
    assert (target / "figures" / "scene.png").read_bytes() == b"ours"
    assert (target / "figures" / "scene.png.kept").read_bytes() == b"drawn by hand"
    write(target, {"sets.npz": b"3", "figures/scene.png": b"ours again"})
    assert (target / "figures" / "scene.png").read_bytes() == b"ours again"
    assert (target / "figures" / "scene.png.kept").read_bytes() == b"drawn by hand"


def test_links_are_kept_and_never_followed(tmp_path):
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "data").write_bytes(b"precious")
    target = write(tmp_path / "run", {"sets.npz": b"1", "figures/scene.png": b"1"})
    (target / "link").symlink_to(outside)
    (target / "figures" / "file").symlink_to(outside / "data")
    (target / "nowhere").symlink_to("does/not/exist")
    write(target, {"sets.npz": b"2"})
    assert (
        os.readlink(target / "link") == str(outside) and os.readlink(target / "nowhere") == "does/not/exist"
    )
    assert contents(outside) == {"data": b"precious"}
    (target / "sets.npz").unlink()
    (target / "sets.npz").symlink_to(outside / "data")
    with pytest.raises(ScenarioError, match="sets.npz in it is a symbolic link"):
        check_target(target)
    assert contents(outside) == {"data": b"precious"}


NAMES = st.sampled_from(
    ["a", "b", "figures/a", "figures/b", "run/a", "c/d/e", "report.html", "x.kept", "b/c"]
)


def together(*sets):
    """No file of these sets is a folder in another."""
    names = {name for names in sets for name in names}
    return not any(other.startswith(f"{name}/") for name in names for other in names)


@given(st.sets(NAMES, min_size=1), st.sets(NAMES), st.sets(NAMES, min_size=1))
def test_whatever_was_there_only_ours_goes(tmp_path_factory, first, theirs, second):
    """Random folders: files of others survive to the byte, ours are those of the newer run alone."""
    assume(together(first, theirs) and together(second))
    target = tmp_path_factory.mktemp("any") / "run"
    write(target, dict.fromkeys(first, b"first"))
    for name in theirs:  # files of their own, and edited ones of ours
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        (target / name).write_bytes(f"theirs {name}".encode())
    write(target, dict.fromkeys(second, b"second"))
    files = contents(target)
    del files[ownership.MANIFEST]
    assert {name for name, text in files.items() if text == b"second"} == second
    assert b"first" not in files.values()
    kept = sorted(text for text in files.values() if text != b"second")
    assert kept == sorted(f"theirs {name}".encode() for name in theirs)
    assert {name for name in theirs if together({name}, second)} - second <= set(files)
    assert [path.name for path in target.parent.iterdir()] == ["run"]


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ({"thesis.tex": "all of it"}, "other contents"),
        ({"summary.json": '{"of": "another program"}'}, "other contents"),
        ({"summary.json": '{"schema_version": 1, "scenario": "x"}'}, "other contents"),
        ({"manifest.json": "{}", "summary.json": '{"schema_version": 1, "scenario": "x"}'}, "other contents"),
        ({".polaris.json": '{"format": "polaris folder", "files": ["a"]}', "a": "1"}, "other contents"),
        ({ownership.MANIFEST: '{"format": "something else", "files": []}\n'}, "not as Polaris wrote it"),
        ({ownership.MANIFEST: ""}, "not as Polaris wrote it"),
    ],
)
def test_folders_that_are_none_of_ours_are_refused(tmp_path, files, words):
    for name, text in files.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    before = contents(tmp_path)
    with pytest.raises(ScenarioError, match=words):
        check_target(tmp_path)
    assert contents(tmp_path) == before


def line(name, before=""):
    """A line of a list whose link fits."""
    known = hashlib.sha256(b"mine").hexdigest()
    return json.dumps([name, known, ownership._link(before, name, known)])


@pytest.mark.parametrize(
    "lines",
    [
        [line("../precious")],
        [line("/precious")],
        [line("x/../../precious")],
        [line("./precious")],
        [line("precious").replace("precious", "precious2")],  # edited: the link no longer fits
        [line("a", "another line")],  # a line was taken out
        ["[]"],
        ["{"],
        ["[1, 2, 3]"],
        ["[" * 100_000],
    ],
)
def test_an_edited_list_is_nobodys(tmp_path, lines):
    """Neither replaced nor added to, and nothing outside is reached."""
    (tmp_path / "precious").write_bytes(b"mine")
    target = write(tmp_path / "run", {"a": b"1"})
    (target / ownership.MANIFEST).write_text("\n".join([ownership.HEADER, *lines, ""]), encoding="utf-8")
    before = contents(tmp_path)
    with pytest.raises(ScenarioError, match="not as Polaris wrote it"):
        check_target(target)
    for replace in (replacing.replacing, replacing.adding):
        with pytest.raises(ScenarioError, match="not as Polaris wrote it"), replace(target) as beside:
            (beside / "a").write_bytes(b"2")
    assert contents(tmp_path) == before


def test_commands_that_add_at_once_leave_a_list_that_fits(tmp_path):
    target = write(tmp_path / "run", {"a": b"1"})
    names = [f"{k}" for k in range(200)]
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda name: ownership.extend_list(target, name, "0"), names))
    assert set(ownership.read_list(target)) == {"a", *names}


def test_a_line_that_a_full_disk_cut_off_is_left_out(tmp_path):
    target = write(tmp_path / "run", {"a": b"1", "b": b"2"})
    with (target / ownership.MANIFEST).open("ab") as file:
        file.write(b'["c", "0123')
    with replacing.adding(target) as beside:
        (beside / "d").write_bytes(b"4")
    assert set(ownership.read_list(target)) == {"a", "b", "d"}


# -- before the work ----------------------------------------------------------------------------------


def test_places_that_cannot_be_written_are_found_by_trying(tmp_path, monkeypatch):
    """Whatever the permissions say: a file system may be read-only, full of folders, or not real."""
    real = Path.mkdir

    def refuse(self, *args, **more):
        if ".new-" in self.name:
            raise OSError(errno.EROFS, "Read-only file system", str(self))
        real(self, *args, **more)

    monkeypatch.setattr(Path, "mkdir", refuse)
    for check in (check_target, check_file):
        with pytest.raises(ScenarioError, match=r"not a writable folder \(Read-only file system\)"):
            check(tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="needs /proc")
def test_folders_that_are_not_on_a_disk_are_refused():
    for out in ("/proc/polaris", "/proc/self/polaris/deep"):
        with pytest.raises(ScenarioError, match="--out"):
            check_target(out)


def test_names_too_long_for_what_is_written_beside_are_found(tmp_path):
    with pytest.raises(ScenarioError, match="--out"):
        check_target(tmp_path / ("x" * 250))


def test_mounted_folders_are_refused(tmp_path, monkeypatch):
    target = write(tmp_path / "run", {"a": b"1"})
    monkeypatch.setattr(os.path, "ismount", lambda path: Path(path) == target)
    with pytest.raises(ScenarioError, match="mounted"):
        check_target(target)


def test_unwritable_files_are_found_before_the_work(tmp_path, monkeypatch):
    """Every command that writes a file asks first."""
    from typer.testing import CliRunner

    from polaris.cli import app as cli

    def work(*args, **more):
        raise AssertionError("the work had begun")

    for name in (
        "polaris.runs.case.CommandTarget.schedule",
        "polaris.runs.campaign.drive.replay_run",
        "polaris.traces.export.export_run",
        "polaris.report.report_page",
        "polaris.synthesis.safety.get_safety.get_safety",
        "polaris.synthesis.schedule.synthesize.synthesize",
        "polaris.inspection.flights.simulation.fly_one",
    ):
        monkeypatch.setattr(name, work)
    monkeypatch.setattr("polaris.runs.campaign.folder.read_campaign", lambda path: None)
    monkeypatch.chdir(tmp_path)
    place = "no/such/folder/file.json"
    (tmp_path / "file").write_bytes(b"")
    for line in (
        f"falsify {TINY} --out {place}",
        "campaign-replay c --case 0 --batch 0 --run 0 --out no/such/folder/file.csv",
        f"export run {place}",
        f"report run --out {place}",
        f"run {TINY} --out file/in/a/file",
        "run inspection --out file/in/a/file",
        f"compare {TINY} --out file/in/a/file",
    ):
        done = CliRunner().invoke(cli.app, line.split())
        assert done.exit_code == 2 and "error: " in done.stderr, (line, done.output)
        assert "work had begun" not in done.output


# -- killed, or out of room ---------------------------------------------------------------------------


def test_what_a_killed_run_left_is_cleared_away(tmp_path):
    target = write(tmp_path / "run", {"a": b"1"})
    left = left_by_a_dead_process(target)
    mine = tmp_path / f".run.new-{ownership.host()}-{os.getpid()}-0123abcd"  # at work right now
    other = tmp_path / ".run.new-elsewhere-1-0123abcd"  # of another machine
    alike = [
        left.with_name(f"{left.name[:-8]}{n:08}".replace("new", word))
        for n, word in enumerate(("new", "old"))
    ]
    for folder in (mine, other, *alike):
        folder.mkdir()
        (folder / "data").write_bytes(b"of somebody who likes such names")
    write(target, {"a": b"2"})
    assert not left.exists() and all((folder / "data").exists() for folder in (mine, other, *alike))


def test_an_older_campaign_does_not_come_back_into_a_newer_one(tmp_path):
    target = write(tmp_path / "c", {"manifest.json": b"old"})
    with replacing.adding(target, "runs") as beside:
        (beside / "case-0007-batch-00000.parquet").write_bytes(b"old")
    left = left_by_a_dead_process(target, "old")
    ownership.remove(left)
    target.rename(left)
    write(tmp_path / "n", {"manifest.json": b"new"}).rename(target)
    tidy(tmp_path)
    assert set(contents(target)) == {"manifest.json", ownership.MANIFEST} and not left.exists()


def test_an_old_folder_is_put_back_if_the_run_was_killed_between(tmp_path):
    target = tmp_path / "run"
    left = left_by_a_dead_process(target, "old")
    tidy(tmp_path)
    assert (target / "half").read_bytes() == b"half" and not left.exists()
    again = left_by_a_dead_process(target, "old")
    (again / "notes.txt").write_bytes(b"came at the last moment")
    tidy(tmp_path)
    assert not again.exists() and (target / "notes.txt").read_bytes() == b"came at the last moment"


KILLED = """
import os, signal, sys
from pathlib import Path
from polaris.runs.files import atomic, ownership

step, word = int(sys.argv[2]), sys.argv[1]
calls = 0
def count(real):
    def call(*args, **more):
        global calls
        calls += 1
        if calls == step:
            os.kill(os.getpid(), signal.SIGKILL)
        return real(*args, **more)
    return call
for name in ("rename", "mkdir", "unlink", "rmdir", "write_text"):
    setattr(Path, name, count(getattr(Path, name)))
for name in ("link", "unlink", "replace"):
    setattr(os, name, count(getattr(os, name)))
ownership.extend_list = atomic.extend_list = count(ownership.extend_list)
with getattr(atomic, sys.argv[3])(Path("run")) as beside:
    for name in ("a", "b"):
        (beside / name).write_bytes(word.encode())
print(calls)
"""


def test_killed_at_any_moment_a_folder_is_whole(tmp_path):
    """After every single step on the way: the older or the newer run, all of it, and every foreign file."""
    target, step = tmp_path / "run", 1
    write(target, {"a": b"old", "b": b"old"})
    (target / "notes").write_bytes(b"mine")
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    while True:
        command = [sys.executable, "-c", KILLED, "new", str(step), "replacing"]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, timeout=60)
        tidy(tmp_path)
        files = contents(target)
        assert files.pop("notes") == b"mine"
        assert (files["a"], files["b"]) in {(b"old", b"old"), (b"new", b"new")}, step
        assert [path.name for path in tmp_path.iterdir()] == ["run"], step
        if done.returncode == 0:
            break
        assert done.returncode == -signal.SIGKILL, done.stderr
        write(target, {"a": b"old", "b": b"old"})
        step += 1
    assert step > 6


def test_killed_at_any_moment_files_that_are_added_are_whole_and_listed(tmp_path):
    """Each is the older or the newer one, and the next command replaces it without a complaint."""
    target, step, code = write(tmp_path / "run", {"a": b"old", "b": b"old"}), 1, None
    (target / "notes").write_bytes(b"mine")
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    while code != 0:
        command = [sys.executable, "-c", KILLED, "new", str(step), "adding"]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, timeout=60)
        code, step = done.returncode, step + 1
        assert code in (0, -signal.SIGKILL), done.stderr
        files = contents(target)
        assert files["notes"] == b"mine" and {files["a"], files["b"]} <= {b"old", b"new"}
        for word in (b"newer", b"old"):
            with replacing.adding(target) as beside:
                for name in ("a", "b"):
                    (beside / name).write_bytes(word)
            assert set(contents(target)) == {"a", "b", "notes", ownership.MANIFEST}, step
    assert step > 6


FULL = """
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
sys.path.insert(0, ".")
from polaris.cli.app import app
from tests.polaris.tiny import TINY
import polaris.runs.run  # the libraries may write caches of their own
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), resource.RLIM_INFINITY))
app(["run", str(TINY), "--out", sys.argv[1], "-q", *sys.argv[3:]])
"""


@pytest.mark.skipif(os.name != "posix", reason="needs limits on file sizes")
@pytest.mark.parametrize("size", [2000, pytest.param(9000, marks=pytest.mark.slow)])
def test_a_full_disk_names_the_path_and_the_way_on(tmp_path, size):
    target = write(tmp_path / "run", {"summary.json": b"old"})
    (target / "notes").write_bytes(b"mine")
    before = contents(target)
    command = [
        sys.executable,
        "-c",
        FULL,
        str(target),
        str(size),
        "--no-figures",
        "--set",
        "simulation.runs=1",
    ]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    lines = done.stderr.strip().splitlines()
    assert done.returncode == 2 and len(lines) == 1, done.stderr
    assert str(target) in lines[0] and "File too large" in lines[0]
    assert "the previous content is unchanged" in lines[0] and "same command again" in lines[0]
    assert contents(target) == before and [path.name for path in tmp_path.iterdir()] == ["run"]


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), True),
        (OSError(errno.EDQUOT, "Disk quota exceeded"), True),
        (OSError("24 requested and 0 written"), True),
        (OSError(errno.EROFS, "Read-only file system"), False),
    ],
)
def test_every_way_a_disk_refuses_is_one_message(tmp_path, error, said):
    nested = tmp_path / "out" / "run"
    with pytest.raises(CannotWrite) as refusal, replacing.replacing(tmp_path / "out") as beside:  # noqa: SIM117
        with replacing.replacing(beside / "run"):
            raise error
    assert str(tmp_path / "out") in str(refusal.value) and "nothing was written" in str(refusal.value)
    assert ("Free some space" in str(refusal.value)) == said and ".new-" not in str(refusal.value)
    assert list(tmp_path.iterdir()) == [] and not nested.exists()
    with (
        pytest.raises(CannotWrite, match="nothing was written"),
        replacing.replacing_file(tmp_path / "x.csv"),
    ):
        raise error
