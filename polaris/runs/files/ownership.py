"""Lists of the files that Polaris wrote into folders, each with its hash: all other files are the user's.

A list has a line of JSON per file: its path, its SHA-256, and a link, which is a hash of this and all
earlier lines. Lines are only ever appended. A file is Polaris's if a line of the list has its path and its
hash. A list whose links do not fit was edited or made by something else: its folder is not Polaris's.
"""

import filecmp
import hashlib
import json
import os
import platform
import re
import secrets
import shutil
import time
from contextlib import suppress
from pathlib import Path, PurePosixPath

from reach.numerics.files import open_regular, read_regular

from ...model.errors import ScenarioError

try:
    import fcntl
except ImportError:  # elsewhere than on POSIX
    fcntl = None  # type: ignore[assignment]

MANIFEST = ".polaris.jsonl"  # name of the list
HEADER = json.dumps({"format": "polaris folder", "format_version": 2, "lines": "path, SHA-256, link"})
EDITED = f"{MANIFEST} in it is not as Polaris wrote it, so nothing in it is replaced; give another folder"
LARGEST_LIST = 2**28  # largest list that is read [bytes]; a line has about 150
LARGEST_FILE = 2**40  # largest file that is hashed [bytes]
LONG = 86400.0  # age [s] at which what lies half done belongs to nobody, whatever machine wrote it


def sha256(path: Path) -> str:
    """Return the SHA-256 of a regular file; raise `OSError` for anything else."""
    with open_regular(path, LARGEST_FILE) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _link(previous: str, name: str, digest: str) -> str:
    return hashlib.sha256(f"{previous}\n{name}\n{digest}".encode()).hexdigest()[:16]


def read_list(folder: Path) -> dict[str, set[str]] | None:
    """Return the hashes of the files that Polaris wrote into a folder, by path; None without a list.

    `ScenarioError` if the list was edited, is damaged, or is that of another version or program.
    """
    if not os.path.lexists(folder / MANIFEST):
        return None
    files: dict[str, set[str]] = {}
    try:
        header, *lines, _ = read_regular(folder / MANIFEST, LARGEST_LIST).decode().split("\n")
        if header != HEADER or (folder / MANIFEST).is_symlink():
            raise ValueError("another format")
        previous = ""
        for line in lines:
            name, digest, link = json.loads(line)
            previous, path = _link(previous, name, digest), PurePosixPath(name)
            if link != previous or path.is_absolute() or ".." in path.parts or name != str(path):
                raise ValueError("lines that do not fit")
            files.setdefault(name, set()).add(digest)
    except (OSError, ValueError, TypeError, RecursionError) as error:
        raise ScenarioError("folder", str(folder), EDITED) from error
    return files


def start_list(folder: Path) -> None:
    """Begin the list of a folder, with no file in it."""
    (folder / MANIFEST).write_text(HEADER + "\n", encoding="utf-8", newline="\n")


def extend_list(folder: Path, name: str, digest: str) -> None:
    """Append a file to the list of a folder; raise `ScenarioError` if the list is not Polaris's."""
    with (folder / MANIFEST).open("r+b") as file:
        if fcntl is not None:
            fcntl.flock(file, fcntl.LOCK_EX)  # two commands may add to one folder
        header, size = file.readline(), file.seek(0, os.SEEK_END)
        file.seek(max(size - 2**16, 0))
        *_, last, torn = file.read().split(b"\n")
        try:
            previous = "" if last + b"\n" == header else str(json.loads(last)[2])
            if header.decode() != HEADER + "\n" or (folder / MANIFEST).is_symlink():
                raise ValueError("another format")
        except (ValueError, LookupError, TypeError) as error:
            raise ScenarioError("folder", str(folder), EDITED) from error
        file.seek(size - len(torn))  # a full disk may have cut the last line off
        file.truncate()
        file.write((json.dumps([name, digest, _link(previous, name, digest)]) + "\n").encode())


def write_list(folder: Path) -> None:
    """List all files of a folder that is new, those of the folders in it too."""
    listed = read_list(folder) or {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.name == MANIFEST and name != MANIFEST:
            path.unlink()
        elif path.is_file() and name != MANIFEST and (digest := sha256(path)) not in listed.get(name, ()):
            extend_list(folder, name, digest)


def list_holder(folder: Path) -> Path:
    """Return the folder with the list of a folder's files: itself, or that above of which it is a part."""
    if not os.path.lexists(folder / MANIFEST):
        with suppress(ScenarioError):
            if any(name.startswith(f"{folder.name}/") for name in read_list(folder.parent) or ()):
                return folder.parent
    return folder


def linked(folder: Path, name: str) -> bool:
    """Return True if a path within a folder is a symbolic link, or leads through one."""
    path = Path(name)
    return any((folder / part).is_symlink() for part in (path, *path.parents[:-1]))


class OwnedPaths:
    """Paths in a folder that Polaris wrote and nobody changed since, by the list of the folder."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.listed = folder, read_list(folder) or {}
        self.folders = {str(parent) for name in self.listed for parent in PurePosixPath(name).parents}

    def __contains__(self, name: str) -> bool:
        if name not in self.listed or linked(self.folder, name):
            return False
        try:
            return sha256(self.folder / name) in self.listed[name]
        except OSError:
            return False


def spare(root: Path, name: str, original: Path) -> Path:
    """Return where a file is kept: its path, with ``.kept`` added to each part that another file has."""
    place, (*parents, last) = root, name.split("/")
    for part in parents:
        place = next(path for path in _names(place / part) if not os.path.lexists(path) or _is_folder(path))
    return next(path for path in _names(place / last) if not os.path.lexists(path) or _same(path, original))


def _names(path: Path) -> "map[Path]":
    return map(path.with_name, (path.name + f".kept{i or ''}" * (i >= 0) for i in range(-1, 1000)))


def _is_folder(path: Path) -> bool:
    return path.is_dir() and not path.is_symlink()


def _same(one: Path, other: Path) -> bool:
    if os.path.samestat(one.lstat(), other.lstat()):
        return True
    if one.is_symlink() or other.is_symlink():
        return one.is_symlink() and other.is_symlink() and os.readlink(one) == os.readlink(other)
    return one.is_file() and other.is_file() and filecmp.cmp(one, other, shallow=False)


def _others(folder: Path) -> list[tuple[str, Path]]:
    """List everything in a folder that is not Polaris's, and empty folders; links are not followed."""
    owned, others = OwnedPaths(folder), list[tuple[str, Path]]()
    for parent, folders, names in os.walk(folder):
        for path in sorted(Path(parent) / name for name in (*names, *folders)):
            name = path.relative_to(folder).as_posix()
            if not (name in owned.folders if _is_folder(path) else name == MANIFEST or name in owned):
                others.append((name, path))
    return others


def keep(old: Path, new: Path) -> None:
    """Link files not of Polaris from an old folder into the new one; links are copied, never followed."""
    for name, path in _others(old):
        place = spare(new, name, path)
        if _is_folder(path):
            if not os.path.lexists(new / name):
                (new / name).mkdir(parents=True)
                shutil.copystat(path, new / name)
        elif not os.path.lexists(place):
            place.parent.mkdir(parents=True, exist_ok=True)
            _copy(path, place)


def _copy(source: Path, place: Path) -> None:
    if source.is_symlink():
        place.symlink_to(os.readlink(source))
        return
    try:
        os.link(source, place, follow_symlinks=False)
    except OSError:
        if not source.is_file():
            raise
        shutil.copy2(source, place, follow_symlinks=False)


def discard(old: Path, target: Path) -> None:
    """Delete an old folder that has been replaced; files that came into it at the last moment move on."""
    others = dict(_others(old))
    for parent, folders, names in os.walk(old, topdown=False):
        for path in (Path(parent) / name for name in (*names, *folders)):
            name = path.relative_to(old).as_posix()
            with suppress(OSError):
                if _is_folder(path):
                    path.rmdir()
                elif name in others and not os.path.lexists(place := spare(target, name, path)):
                    place.parent.mkdir(parents=True, exist_ok=True)
                    path.rename(place)
                elif name != MANIFEST:
                    path.unlink()
    remove(old, empty=True)


def remove(folder: Path, empty: bool = False) -> None:
    """Delete a folder that Polaris made, its list last; only if it is `empty` otherwise, if asked so."""
    with suppress(OSError):
        for entry in list(os.scandir(folder)) if not empty else ():
            if entry.is_dir(follow_symlinks=False):
                shutil.rmtree(entry.path, ignore_errors=True)
            elif entry.name != MANIFEST:
                os.unlink(entry.path)
        if os.listdir(folder) == [MANIFEST]:
            (folder / MANIFEST).unlink()
        folder.rmdir()


def host() -> str:
    """Return the name of the machine, as names of files carry it."""
    return re.sub(r"[^A-Za-z0-9]", "", platform.node())[:20] or "host"


def beside_name(name: str, word: str) -> str:
    """Return a name for a folder that is being written ("new") or replaced ("old") beside a place."""
    return f".{name}.{word}-{host()}-{os.getpid()}-{secrets.token_hex(4)}"


def tidy(folder: Path, name: str = "") -> None:
    """Clear away (or put back) files that killed processes left in a folder: of this machine, or a day old.

    It stands for `name`, or for any file. Only folders with a list are touched, and empty ones.
    """
    form = re.compile(rf"\.({re.escape(name) or '.+'})\.(new|old)-(\w+)-(\d+)-[0-9a-f]{{8}}")
    try:
        matches = [(path, form.fullmatch(path.name)) for path in sorted(folder.iterdir())]
    except OSError:
        return
    for path, match in matches:
        if match is None or not _is_folder(path) or not _abandoned(path, match[3], int(match[4])):
            continue
        target = folder / match[1]
        with suppress(OSError, ScenarioError):
            if read_list(path) is None:
                path.rmdir()  # only if it is empty
            elif match[2] == "new":
                remove(path)
            elif os.path.lexists(target):
                discard(path, target)
            else:
                path.rename(target)


def _abandoned(path: Path, machine: str, process: int) -> bool:
    if machine == host() and os.name == "posix":  # elsewhere asking may end the process
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
