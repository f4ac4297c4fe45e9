"""What in a folder Polaris wrote, and what is somebody else's; and what killed processes leave."""

import json
import os
import platform
import re
import secrets
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from fnmatch import fnmatchcase
from pathlib import Path

MANIFEST = ".polaris.json"  # list of what Polaris wrote into a folder
NESTED = ("figures", "run", "run/figures")
"""Folders in a folder of ours that are replaced on their own, and then have a manifest too."""

LATER = ("report.html",)  # files of ours that come into a folder later
CAMPAIGN = "manifest.json"  # file by which a campaign is known

RESULTS = (
    CAMPAIGN,
    "summary.json",
    "runs/",
    "runs/case-*-batch-*.parquet",
    "runs/case-*-batch-*.npz",
    "failed/",
    "failed/case-*.json",
    "scenario.toml",
    "failures.csv",
)
"""What a campaign writes into its folder as it goes."""

FORMAT = "polaris folder"
LONG = 86400.0  # age [s] at which what lies half done belongs to nobody, whatever machine wrote it


def write_manifest(folder: Path) -> None:
    """List what is in a folder, folders with a slash."""
    paths = folder.rglob("*")
    files = [path.relative_to(folder).as_posix() + ("/" if path.is_dir() else "") for path in paths]
    told = {"format": FORMAT, "format_version": 1, "files": sorted(files)}
    (folder / MANIFEST).write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8", newline="\n")


def listed(folder: Path) -> list[str] | None:
    """What the manifest of a folder lists, None if there is none that can be read."""
    try:
        told = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
        return [str(name) for name in told["files"]] if told["format"] == FORMAT else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


class Ours:
    """Which paths in a folder Polaris wrote, by the manifests of the folder and of what it nests."""

    def __init__(self, folder: Path, also: tuple[str, ...] = ()) -> None:
        self.names: set[str] = set()
        self.also: tuple[str, ...] = (*also, *LATER)
        for inside in ("", *(f"{name}/" for name in NESTED)):
            found = listed(folder / inside)
            if found is not None:
                self.names |= {inside, *(inside + name for name in (*found, MANIFEST))}
        if CAMPAIGN in self.names:
            self.also += RESULTS

    def __call__(self, name: str) -> bool:
        """Whether a path relative to the folder, of a folder with a slash at the end, is ours."""
        return name in self.names or any(fnmatchcase(name, pattern) for pattern in self.also)

    def __iter__(self) -> Iterator[str]:
        return iter({name.rstrip("/") for name in self.names} - {""})


def keep(old: Path, new: Path, ours: Callable[[str], bool], inside: str = "") -> None:
    """Link what is not ours from an old folder into the new one; links are copied, never followed."""
    for entry in sorted(os.scandir(old / inside), key=lambda entry: entry.name):
        name, place = f"{inside}{entry.name}", new / inside / entry.name
        if entry.is_dir(follow_symlinks=False):
            if not ours(f"{name}/") and not os.path.lexists(place):
                place.mkdir(parents=True)
                shutil.copystat(entry.path, place)
            keep(old, new, ours, f"{name}/")
        elif not ours(name):
            if os.path.lexists(place):
                names = (place.with_name(f"{place.name}.kept{number or ''}") for number in range(1000))
                place = next(name for name in names if not os.path.lexists(name))
            place.parent.mkdir(parents=True, exist_ok=True)
            _link(Path(entry.path), place)


def _link(source: Path, place: Path) -> None:
    if source.is_symlink():
        place.symlink_to(os.readlink(source))
        return
    try:
        os.link(source, place, follow_symlinks=False)
    except OSError:
        if not source.is_file():
            raise
        shutil.copy2(source, place, follow_symlinks=False)


def discard(aside: Path, target: Path, ours: Callable[[str], bool]) -> None:
    """Delete an old folder that has been replaced; what came into it at the last moment is moved on."""
    for here, folders, names in os.walk(aside, topdown=False):
        for name in (*names, *folders):
            path = Path(here) / name
            inside = path.relative_to(aside)
            with suppress(OSError):
                if path.is_dir() and not path.is_symlink():
                    path.rmdir()
                elif ours(inside.as_posix()) or os.path.lexists(target / inside):
                    path.unlink()
                else:
                    (target / inside).parent.mkdir(parents=True, exist_ok=True)
                    path.rename(target / inside)
    with suppress(OSError):
        aside.rmdir()


def host() -> str:
    """Name of the machine, as names of files carry it."""
    return re.sub(r"[^A-Za-z0-9]", "", platform.node())[:20] or "host"


def beside_name(name: str, word: str) -> str:
    """Name of what is being written ("new") or replaced ("old") beside a place."""
    return f".{name}.{word}-{host()}-{os.getpid()}-{secrets.token_hex(4)}"


def tidy(target: Path) -> None:
    """Clear away (or put back) what killed processes left beside a place: of this machine, or a day old."""
    tidy_all(target.parent, re.escape(target.name))


def tidy_all(folder: Path, name: str = ".+") -> None:
    """The same for all in a folder whose names fit a regular expression."""
    form = re.compile(rf"\.({name})\.(new|old)-(\w+)-(\d+)-[0-9a-f]{{8}}(\.\w+)?")
    try:
        found = [(path, form.fullmatch(path.name)) for path in sorted(folder.iterdir())]
    except OSError:
        return
    for path, match in found:
        if match is None or not _abandoned(path, match[3], int(match[4])):
            continue
        target = folder / match[1]
        with suppress(OSError):
            if match[2] == "old" and os.path.lexists(target):
                discard(path, target, Ours(path))
            elif match[2] == "old":
                path.rename(target)
            elif path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)


def _abandoned(path: Path, where: str, process: int) -> bool:
    if where == host() and os.name == "posix":  # elsewhere asking may end the process
        try:
            os.kill(process, 0)
        except (ProcessLookupError, OverflowError):
            return True
        except OSError:
            pass
    try:
        return time.time() - path.lstat().st_ctime > LONG
    except OSError:
        return False
