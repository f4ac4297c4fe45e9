"""Folders and files that appear whole or not at all, and replace only what Polaris wrote.

Written beside, under a hidden name with host and process, and renamed into place. What the `MANIFEST` of a
folder does not list is somebody else's, and is linked into the folder that takes its place.
"""

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ..model.errors import ScenarioError
from .ownership import CAMPAIGN, Ours, beside_name, discard, keep, listed, tidy, write_manifest

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
REFUSED = (errno.EIO, errno.EROFS, errno.EACCES, errno.EPERM, errno.ENAMETOOLONG, errno.ENOTDIR, None)


class CannotWrite(ScenarioError):
    """A place turned out not to take what was to be written there."""

    def __init__(self, field: str, target: Path, error: OSError, before: bool) -> None:
        told = " ".join((error.strerror or str(error)).split())
        rule = f"cannot be written: {told}"
        rule += "; what was there before is unchanged" if before else "; nothing is left there"
        if error.errno in (*FULL, None):
            rule += ". Free some space, or give another place, and run the same command again"
        super().__init__(field, str(target), rule)


def check_target(out: str | Path, campaign: bool = False) -> Path:
    """Whether a folder (or a `campaign`) may be replaced or made there, by trying: its absolute path.

    What killed processes left there is cleared away; `ScenarioError` if not.
    """
    try:
        target = Path(out).resolve()
        if target == Path.cwd() or target in Path.cwd().parents:
            raise ScenarioError("--out", str(out), "must not be the current folder or one above it")
        tidy(target)
        if target.exists():
            _check_existing(target, out, campaign)
        nearest = next(parent for parent in target.parents if parent.exists())
        _try_writing(nearest, target.name, out)
    except (OSError, ValueError) as error:
        raise ScenarioError("--out", str(out), f"must be a usable path ({error})") from error
    return target


def check_file(out: str | Path, field: str = "--out", endings: tuple[str, ...] = ()) -> Path:
    """Whether a file may be written there, found out by trying; `field` is what messages call it.

    `ScenarioError` if it is a folder, a part of a result, of another ending, or cannot be written.
    """
    target = Path(out)
    try:
        if endings and target.suffix.lower() not in endings and not target.is_dir():
            raise ScenarioError(field, str(out), f"must end with {' or '.join(endings)}")
        if target.is_dir():
            raise ScenarioError(field, str(out), "is a folder; must be a file")
        if not target.parent.is_dir():
            raise ScenarioError(field, str(out), f"there is no folder {target.parent}")
        if target.name in (listed(target.parent) or ()):
            rule = f"is a part of the results in {target.parent}, which would be lost; give another name"
            raise ScenarioError(field, str(out), rule)
        tidy(target)
        _try_writing(target.parent, target.name, out, field)
    except (OSError, ValueError) as error:
        raise ScenarioError(field, str(out), f"must be a usable path ({error})") from error
    return target


def _check_existing(target: Path, out: str | Path, campaign: bool) -> None:
    def refuse(rule: str) -> None:
        raise ScenarioError("--out", str(out), rule)

    if not target.is_dir():
        refuse("is a file; must be a folder")
    if os.path.ismount(target):
        refuse("is where a file system is mounted, which cannot be replaced; give a folder in it")
    if any(target.iterdir()):
        if (target / CAMPAIGN).is_file() and not campaign:
            refuse("holds a campaign; it will not be replaced")
        if not campaign and listed(target) is None:
            refuse("is a folder with other contents; it will not be replaced")
    for name in sorted(Ours(target)):
        if (target / name).is_symlink():
            refuse(f"{name} in it is a symbolic link; Polaris does not write through links")
    if not os.access(target, os.R_OK | os.W_OK | os.X_OK):
        refuse("is a folder that cannot be written to")
    above = target.parent.stat()
    sticky = above.st_mode & 0o1000 and hasattr(os, "geteuid")
    if sticky and os.geteuid() not in (0, above.st_uid, target.stat().st_uid):
        refuse(f"belongs to somebody else, and folders in {target.parent} can be renamed by their owner only")


def _try_writing(folder: Path, name: str, out: str | Path, field: str = "--out") -> None:
    """Make a folder beside with a file in it, as the result will be made, and remove both."""
    trial = folder / beside_name(name, "new")
    try:
        trial.mkdir()
        try:
            (trial / "x").write_bytes(b"x")
        finally:
            shutil.rmtree(trial, ignore_errors=True)
    except OSError as error:
        rule = f"cannot be made: {folder} is not a writable folder ({error.strerror or error})"
        raise ScenarioError(field, str(out), rule) from error


@contextmanager
def replacing(target: Path, also: tuple[str, ...] = ()) -> Iterator[Path]:
    """A new folder beside `target` that takes its place if all goes well, and is removed if not.

    Only what Polaris wrote goes: what manifests list or fits the patterns `also`; the rest is linked, with
    ``.kept`` where its name is needed. Killed in between, the older folder is whole, and put back next time.
    """
    tidy(target)
    beside, aside = (target.with_name(beside_name(target.name, word)) for word in ("new", "old"))
    try:
        beside.mkdir(parents=True)
        yield beside
        write_manifest(beside)
        ours = Ours(target, also)
        if target.exists():
            shutil.copymode(target, beside)
            keep(target, beside, ours)
            target.rename(aside)
        try:
            beside.rename(target)
        except OSError:
            if aside.exists():
                aside.rename(target)
            raise
    except BaseException as error:
        shutil.rmtree(beside, ignore_errors=True)
        cause = error.__cause__ if isinstance(error, CannotWrite) else error
        if isinstance(cause, OSError) and cause.errno in (*FULL, *REFUSED):
            raise CannotWrite("--out", target, cause, target.exists()) from cause
        raise
    discard(aside, target, ours)


@contextmanager
def replacing_file(target: Path, field: str = "--out") -> Iterator[Path]:
    """A file beside `target`, with the same suffix, that takes its place if all goes well."""
    beside = target.with_name(beside_name(target.name, "new") + target.suffix)
    try:
        yield beside
        os.replace(beside, target)
    except BaseException as error:
        with suppress(OSError):
            beside.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise CannotWrite(field, target, error, target.exists()) from error
        raise


def write_whole(path: Path, text: str) -> None:
    """Write a text file: whole, or not at all."""
    with replacing_file(path) as beside:
        beside.write_text(text, encoding="utf-8", newline="\n")
