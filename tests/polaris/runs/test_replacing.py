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
from tests.polaris.tiny import flown, synthesised

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
    with replacing.replacing(target) as staging:
        for name, text in files.items():
            (staging / name).parent.mkdir(parents=True, exist_ok=True)
            (staging / name).write_bytes(text)
    return target


def test_a_newer_run_replaces_what_polaris_wrote_and_nothing_else(tmp_path, monkeypatch):
    def draw(picture, folder, figures):
        (folder / "scene.pdf").write_bytes(b"drawn")
        return [folder / "scene.pdf"]

    monkeypatch.setattr("polaris.report.figures.draw_figures", draw)
    scenario, schedule = synthesised()
    target = tmp_path / "run"
    write_run(target, scenario, schedule, flown(), draw=draw_run)
    names = "notes.txt", "figures/mine.png", "archive/2024/scenario.toml", ".git/HEAD"
    user_files = dict.fromkeys(names, b"mine")
    for name, text in user_files.items():
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        (target / name).write_bytes(text)
    (target / "empty").mkdir()
    with replacing.adding(target) as staging:
        (staging / "report.html").write_bytes(b"of the older run")
    other = scenario.with_assignments(["simulation.seed=5"])
    write_run(target, other, schedule, flown())
    files = contents(target)
    assert user_files.items() <= files.items() and (target / "empty").is_dir()
    assert read_run(target).scenario.simulation.seed == 5
    # figures and report of the older run would belong to nothing any more
    assert [name for name in files if name.startswith("figures/")] == ["figures/mine.png"]
    assert "report.html" not in files
    draw_run(read_run(target))
    assert (target / "figures" / "scene.pdf").read_bytes() == b"drawn"
    assert user_files.items() <= contents(target).items()
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_places_that_cannot_hold_a_folder_are_refused(tmp_path, monkeypatch):
    """Not on a disk, under a name that is too long for what is written beside it, or mounted."""
    for out in ("/proc/polaris", "/proc/self/polaris/deep", tmp_path / ("x" * 250)):
        with pytest.raises(ScenarioError, match="--out"):
            check_target(out)
    target = write(tmp_path / "run", {"a": b"1"})
    monkeypatch.setattr(os.path, "ismount", lambda path: Path(path) == target)
    with pytest.raises(ScenarioError, match="mounted"):
        check_target(target)


def test_links_are_kept_and_never_followed(tmp_path):
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "data").write_bytes(b"precious")
    target = write(tmp_path / "run", {"sets.npz": b"1", "figures/scene.png": b"1"})
    links = {"link": str(outside), "figures/file": str(outside / "data"), "nowhere": "does/not/exist"}
    for name, place in links.items():
        (target / name).symlink_to(place)
    write(target, {"sets.npz": b"2"})
    assert links.items() <= contents(target).items()
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
    survivors = sorted(text for text in files.values() if text != b"second")
    assert survivors == sorted(f"theirs {name}".encode() for name in theirs)
    assert {name for name in theirs if together({name}, second)} - second <= set(files)
    assert [path.name for path in target.parent.iterdir()] == ["run"]


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ({"thesis.tex": "all of it"}, "other contents"),
        ({"summary.json": '{"schema_version": 1, "scenario": "x"}', "manifest.json": "{}"}, "other contents"),
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
    checksum = hashlib.sha256(b"mine").hexdigest()
    return json.dumps([name, checksum, ownership._link(before, name, checksum)])


LINES = [
    *([line(name)] for name in ("../precious", "/precious", "x/../../precious", "./precious")),
    [line("precious").replace("precious", "precious2")],  # edited: the link no longer fits
    [line("a", "another line")],  # a line was taken out
    *(["[]"], ["{"], ["[1, 2, 3]"], ["[" * 100_000]),
]


@pytest.mark.parametrize("lines", LINES, ids=range(len(LINES)))
def test_an_edited_list_is_nobodys(tmp_path, lines):
    """Neither replaced nor added to, and nothing outside is reached."""
    (tmp_path / "precious").write_bytes(b"mine")
    target = write(tmp_path / "run", {"a": b"1"})
    (target / ownership.MANIFEST).write_text("\n".join([ownership.HEADER, *lines, ""]), encoding="utf-8")
    before = contents(tmp_path)
    for replace in (replacing.replacing, replacing.adding):
        with pytest.raises(ScenarioError, match="not as Polaris wrote it"), replace(target) as staging:
            (staging / "a").write_bytes(b"2")
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
    with replacing.adding(target) as staging:
        (staging / "d").write_bytes(b"4")
    assert set(ownership.read_list(target)) == {"a", "b", "d"}


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


def test_what_a_killed_run_left_is_cleared_away(tmp_path):
    target = write(tmp_path / "run", {"a": b"1"})
    leftover = left_by_a_dead_process(target)
    running = tmp_path / f".run.new-{ownership.host()}-{os.getpid()}-0123abcd"  # at work right now
    other = tmp_path / ".run.new-elsewhere-1-0123abcd"  # of another machine
    similar = [
        leftover.with_name(f"{leftover.name[:-8]}{n:08}".replace("new", word))
        for n, word in enumerate(("new", "old"))
    ]
    for folder in (running, other, *similar):
        folder.mkdir()
        (folder / "data").write_bytes(b"of somebody who likes such names")
    write(target, {"a": b"2"})
    assert not leftover.exists() and all((folder / "data").exists() for folder in (running, other, *similar))


def test_an_old_folder_is_put_back_if_the_run_was_killed_between(tmp_path):
    target = tmp_path / "run"
    leftover = left_by_a_dead_process(target, "old")
    tidy(tmp_path)
    assert (target / "half").read_bytes() == b"half" and not leftover.exists()
    changed = left_by_a_dead_process(target, "old")
    (changed / "notes.txt").write_bytes(b"came at the last moment")
    tidy(tmp_path)
    assert not changed.exists() and (target / "notes.txt").read_bytes() == b"came at the last moment"


def test_an_older_campaign_does_not_come_back_into_a_newer_one(tmp_path):
    target = write(tmp_path / "c", {"manifest.json": b"old"})
    with replacing.adding(target, "runs") as staging:
        (staging / "case-0007-batch-00000.parquet").write_bytes(b"old")
    leftover = left_by_a_dead_process(target, "old")
    ownership.remove(leftover)
    target.rename(leftover)
    write(tmp_path / "n", {"manifest.json": b"new"}).rename(target)
    tidy(tmp_path)
    assert set(contents(target)) == {"manifest.json", ownership.MANIFEST} and not leftover.exists()


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


@pytest.mark.parametrize("how", ["replacing", "adding"])
def test_killed_at_any_moment_a_folder_is_whole(how, tmp_path):
    """After every single step: the older or the newer run (of files added each), and every foreign file."""
    target, step, code = write(tmp_path / "run", {"a": b"old", "b": b"old"}), 1, None
    (target / "notes").write_bytes(b"mine")
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    while code != 0:
        command = [sys.executable, "-c", KILLED, "new", str(step), how]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, timeout=60)
        code, step = done.returncode, step + 1
        assert code in (0, -signal.SIGKILL), done.stderr
        if how == "replacing":
            tidy(tmp_path)
        files = contents(target)
        assert files["notes"] == b"mine" and {files["a"], files["b"]} <= {b"old", b"new"}
        if how == "replacing":
            assert files["a"] == files["b"] and [path.name for path in tmp_path.iterdir()] == ["run"], step
            write(target, {"a": b"old", "b": b"old"})
            continue
        for word in (b"newer", b"old"):  # the next command replaces them without a complaint
            with replacing.adding(target) as staging:
                for name in ("a", "b"):
                    (staging / name).write_bytes(word)
            assert set(contents(target)) == {"a", "b", "notes", ownership.MANIFEST}, step
    assert step > 6


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), True),
        (OSError("24 requested and 0 written"), True),
        (OSError(errno.EROFS, "Read-only file system"), False),
    ],
)
def test_every_way_a_disk_refuses_is_one_message(tmp_path, error, said):
    with pytest.raises(CannotWrite) as refusal, replacing.replacing(tmp_path / "out") as staging:  # noqa: SIM117
        with replacing.replacing(staging / "run"):
            raise error
    text = str(refusal.value)
    assert str(tmp_path / "out") in text and "nothing was written" in text and "\n" not in text
    assert ("Free some space" in text) == said and ".new-" not in text
    with (
        pytest.raises(CannotWrite, match="nothing was written"),
        replacing.replacing_file(tmp_path / "x.csv"),
    ):
        raise error
    assert list(tmp_path.iterdir()) == []
    before = contents(write(tmp_path / "out", {"summary.json": b"old"}))
    with (
        pytest.raises(CannotWrite, match="the previous content is unchanged"),
        replacing.replacing(tmp_path / "out"),
    ):
        raise error
    assert contents(tmp_path / "out") == before
