"""Folders that appear whole or not at all: written beside, renamed into place."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .errors import ScenarioError

MARKS = ("summary.json", "comparison.json")
"""Files by which a folder is known for one of ours."""


def check_target(out: str | Path) -> Path:
    """Whether a run folder may be written there; returns the absolute path.

    Raises
    ------
    ScenarioError
        If there is something else, which must not be replaced, or the place is not writable.
    """
    try:
        target = Path(out).resolve()
        if target == Path.cwd() or target in Path.cwd().parents:
            raise ScenarioError("--out", str(out), "must not be the current folder or one above it")
        if target.exists():
            if not target.is_dir():
                raise ScenarioError("--out", str(out), "is a file; must be a folder")
            if any(target.iterdir()) and not any((target / name).is_file() for name in MARKS):
                raise ScenarioError(
                    "--out", str(out), "is a folder with other contents; it will not be replaced"
                )
        nearest = next(parent for parent in target.parents if parent.exists())
        if not nearest.is_dir() or not os.access(nearest, os.W_OK | os.X_OK):
            raise ScenarioError("--out", str(out), f"cannot be made: {nearest} is not a writable folder")
    except (OSError, ValueError) as error:
        raise ScenarioError("--out", str(out), f"must be a usable path ({error})") from error
    return target


@contextmanager
def replacing(target: Path) -> Iterator[Path]:
    """A new folder beside `target` that takes its place if all goes well, and is removed if not.

    An older folder is moved aside and deleted last; killed in between, it is whole, under a name
    that begins with a dot.
    """
    token = secrets.token_hex(4)
    beside, aside = (target.with_name(f".{target.name}.{word}-{token}") for word in ("new", "old"))
    try:
        beside.mkdir(parents=True)
    except OSError as error:
        raise ScenarioError("--out", str(target), f"cannot be made: {error.strerror}") from error
    try:
        yield beside
        if target.exists():
            target.rename(aside)
        try:
            beside.rename(target)
        except OSError:
            if aside.exists():
                aside.rename(target)
            raise
    except BaseException:
        shutil.rmtree(beside, ignore_errors=True)
        raise
    shutil.rmtree(aside, ignore_errors=True)
