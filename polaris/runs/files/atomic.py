"""Folders and files that appear whole or not at all, and replace only files that Polaris wrote.

They are written into a hidden folder beside their place, named by host and process, and renamed. What the
list of a folder (`polaris.runs.files.ownership`) does not have with its hash is the user's, and is kept.
"""

import errno
import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal, NoReturn

from ...model.errors import ScenarioError
from .ownership import (
    MANIFEST,
    OwnedPaths,
    beside_name,
    discard,
    extend_list,
    keep,
    linked,
    list_holder,
    read_list,
    remove,
    sha256,
    spare,
    start_list,
    tidy,
    write_list,
)

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
REFUSED = (errno.EIO, errno.EROFS, errno.EACCES, errno.EPERM, errno.ENAMETOOLONG, errno.ENOTDIR, None)
CAMPAIGN = "manifest.json"  # file by which a campaign is known


class CannotWrite(ScenarioError):
    """A place turned out not to take the files to be written there."""

    def __init__(self, field: str, target: Path, error: OSError, existed: bool) -> None:
        cause = " ".join((error.strerror or str(error)).split())
        rule = f"cannot be written: {cause}"
        rule += "; the previous content is unchanged" if existed else "; nothing was written"
        if error.errno in (*FULL, None):
            rule += ". Free some space, or give another place, and run the same command again"
        super().__init__(field, str(target), rule)


def check_target(out: str | Path, names: Iterable[str] = (), campaign: bool = False) -> Path:
    """Return the absolute path of a folder, once it is clear that it may be made or replaced, by trying.

    What killed processes left there is cleared away. Of the files `names`, which will be written into it,
    none may be there unless Polaris wrote it; a campaign may be replaced if `campaign` is True.
    `ScenarioError` names the file of the user that is in the way, or says that nothing can be written there.
    """
    try:
        target = Path(out).resolve()
        if target == Path.cwd() or target in Path.cwd().parents:
            raise ScenarioError("--out", str(out), "must not be the current folder or one above it")
        tidy(target.parent, target.name)
        if target.exists():
            _check_existing(target, out, tuple(names), campaign)
        nearest = next(parent for parent in target.parents if parent.exists())
        try_writing(nearest, target.name, out)
    except (OSError, ValueError) as error:
        raise ScenarioError("--out", str(out), f"must be a usable path ({error})") from error
    return target


def check_file(
    out: str | Path, field: str = "--out", endings: tuple[str, ...] = (), force: bool = False
) -> Path:
    """Return the path of a file, once it is clear that it may be written, by trying.

    Nothing tells whose a single file is, so one that is there is replaced by `force` only. `ScenarioError`,
    which calls it `field`, if it is there, is part of a result, has another ending, or cannot be written.
    """
    target = Path(out)
    try:
        if endings and target.suffix.lower() not in endings and not target.is_dir():
            raise ScenarioError(field, str(out), f"must end with {' or '.join(endings)}")
        if target.is_dir():
            raise ScenarioError(field, str(out), "must be a file, but is a folder")
        if not target.parent.is_dir():
            raise ScenarioError(field, str(out), f"must be in an existing folder, {target.parent} is missing")
        _check_taken(target, field, force)
        tidy(target.parent, target.name)
        try_writing(target.parent, target.name, out, field)
    except (OSError, ValueError) as error:
        raise ScenarioError(field, str(out), f"must be a usable path ({error})") from error
    return target


def _check_taken(target: Path, field: str, force: bool) -> None:
    folder = target.parent.resolve()
    holder = list_holder(folder)
    if (folder.relative_to(holder) / target.name).as_posix() in (read_list(holder) or {}):
        rule = f"is part of the results in {target.parent}; give another name"
        raise ScenarioError(field, str(target), rule)
    if os.path.lexists(target) and not force:
        rule = "exists already; give another name, or --force to replace it"
        raise ScenarioError(field, str(target), rule)


def _check_existing(target: Path, out: str | Path, names: tuple[str, ...], campaign: bool) -> None:
    def refuse(rule: str) -> NoReturn:
        raise ScenarioError("--out", str(out), rule)

    if not target.is_dir():
        refuse("is a file; must be a folder")
    if os.path.ismount(target):
        refuse("is where a file system is mounted, which cannot be replaced; give a folder in it")
    listed = read_list(target)
    if any(target.iterdir()) and listed is None:
        refuse("is a folder with other contents; it will not be replaced")
    if CAMPAIGN in (listed or ()) and not campaign:
        refuse("holds a campaign; it will not be replaced")
    refuse_taken(target, sorted({*names, *(listed or ())}))
    if not os.access(target, os.R_OK | os.W_OK | os.X_OK):
        refuse("is a folder that cannot be written to")
    above = target.parent.stat()
    sticky = above.st_mode & 0o1000 and hasattr(os, "geteuid")
    if sticky and os.geteuid() not in (0, above.st_uid, target.stat().st_uid):
        refuse(f"belongs to somebody else, and folders in {target.parent} can be renamed by their owner only")


def refuse_taken(folder: Path, names: Iterable[str]) -> None:
    """Raise a `ScenarioError` that names the first file in the way which Polaris did not write as it is."""
    owned = OwnedPaths(folder)
    for name in names:
        if os.path.lexists(folder / name) and name not in owned:
            reason = "was changed since Polaris wrote it" if name in owned.listed else "is not Polaris's"
            if linked(folder, name):
                reason = "is a symbolic link or in a linked folder, and Polaris does not write through links"
            rule = f"{name} in it {reason}; move it away, or give another place"
            raise ScenarioError("--out", str(folder), rule)


def try_writing(folder: Path, name: str, out: str | Path, field: str = "--out") -> None:
    """Make a folder beside with a file in it, as the result will be made, and remove both."""
    trial = folder / beside_name(name, "new")
    try:
        trial.mkdir()
        try:
            start_list(trial)
        finally:
            remove(trial)
    except OSError as error:
        rule = f"cannot be made: {folder} is not a writable folder ({error.strerror or error})"
        raise ScenarioError(field, str(out), rule) from error


@contextmanager
def _draft_folder(folder: Path, name: str, field: str, target: Path) -> Iterator[Path]:
    """Make a hidden folder, with a list by which the next run knows it, and remove it at the end."""
    draft = folder / beside_name(name, "new")
    try:
        draft.mkdir(parents=True)
        start_list(draft)
        yield draft
    except BaseException as error:
        cause = error.__cause__ if isinstance(error, CannotWrite) else error
        if isinstance(cause, OSError) and cause.errno in (*FULL, *REFUSED):
            raise CannotWrite(field, target, cause, os.path.lexists(target)) from cause
        raise
    finally:
        remove(draft)


@contextmanager
def replacing(target: Path) -> Iterator[Path]:
    """Make a folder beside `target` that takes its place if all goes well, and is removed if not.

    Only what Polaris wrote goes; all else is linked into the new folder, with ``.kept`` added where its name
    is needed. If the process is killed in between, the older folder is whole, and put back next time.
    """
    tidy(target.parent, target.name)
    old = target.with_name(beside_name(target.name, "old"))
    with _draft_folder(target.parent, target.name, "--out", target) as draft:
        yield draft
        write_list(draft)
        if target.exists():
            shutil.copymode(target, draft)
            keep(target, draft)
            target.rename(old)
        try:
            draft.rename(target)
        except OSError:
            if old.exists():
                old.rename(target)
            raise
    discard(old, target)


@contextmanager
def replacing_file(target: Path, field: str = "--out", force: bool = False) -> Iterator[Path]:
    """Give a path of the same name elsewhere; files written there take the place of `target`."""
    with _draft_folder(target.parent, target.name, field, target) as draft:
        yield draft / target.name
        _check_taken(target, field, force)
        os.replace(draft / target.name, target)


def write_whole(path: Path, text: str, field: str = "--out", force: bool = False) -> None:
    """Write a text file: whole, or not at all."""
    with replacing_file(path, field, force) as draft:
        draft.write_text(text, encoding="utf-8", newline="\n")


@contextmanager
def adding(
    folder: Path, inside: str = "", policy: Literal["refused", "kept", "replaced"] = "refused"
) -> Iterator[Path]:
    """Give a new folder whose files are moved at the end into a folder of results, and listed there.

    They go to the folder `inside` it. Of a file in the way that Polaris did not write as it is, `policy` says
    what becomes: the command is ``refused`` and names it, or it is ``kept``, moved up into `folder` with
    ``.kept`` added to its name, or ``replaced``.
    """
    folder = folder.resolve()
    holder, place = list_holder(folder), folder / inside
    if inside and linked(folder, inside):
        raise ScenarioError("folder", str(place), "is a symbolic link; Polaris does not write through links")
    if not os.path.lexists(holder / MANIFEST):
        start_list(holder)
    tidy(folder)
    with _draft_folder(folder, inside or folder.name, "--out", place) as draft:
        yield draft
        place.mkdir(exist_ok=True)
        prefix = "".join(f"{part}/" for part in place.relative_to(holder).parts)
        new = sorted(path for path in draft.iterdir() if path.name != MANIFEST)
        conflicts = [path for path in new if os.path.lexists(place / path.name)]
        if policy == "refused":
            refuse_taken(holder, [prefix + path.name for path in conflicts])
        for path in conflicts if policy == "kept" else ():
            if prefix + path.name not in OwnedPaths(holder):
                (place / path.name).rename(spare(folder, f"{path.name}.kept", place / path.name))
        for path in new:
            extend_list(holder, prefix + path.name, sha256(path))
            os.replace(path, place / path.name)
