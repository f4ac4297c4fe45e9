"""Schedules that several test files fly, made once: for all workers, and until a source changes.

They lie in ``.pytest_cache/kept``, under a digest of all that they hang on. `make clean` removes them.
"""

import hashlib
import os
import pickle
import platform
import re
import shutil
import sys
from contextlib import contextmanager
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import polaris
import reach
from polaris.scenario.scenario import load_scenario
from polaris.synthesis.schedule.synthesize import synthesize

try:
    import fcntl
except ImportError:  # without locks two workers may make the same thing, each for itself
    fcntl = None

ROOT = Path(__file__).resolve().parents[1]
PLACE = ROOT / ".pytest_cache" / "kept"
LIBRARIES = ("numpy", "scipy", "control", "pulp", "highspy", "gurobipy", "daqp", "pydantic")
GENERATIONS = 3

CHOSEN = "feedback={}"
"""Where tests do not care about the period: it is chosen, and fewer steps are flown."""


def quick(name):
    """Overrides for a bundled scenario whose period is not cared about; none for those that are quick."""
    return [CHOSEN] if name in ("static", "dynamic") else []


@cache
def digest():
    """Of every source and scenario, of what makes scenes for tests, and of what runs them."""
    sums = hashlib.sha256(f"{sys.version} {platform.platform()} {platform.machine()}".encode())
    for name in LIBRARIES:
        try:
            sums.update(f"{name} {version(name)}".encode())
        except PackageNotFoundError:
            sums.update(f"no {name}".encode())
    packages = [Path(package.__file__).parent for package in (polaris, reach)]
    files = [file for package in packages for file in package.rglob("*.py")]
    files += [file for file in ROOT.glob("tests/**/*.py") if not file.name.startswith("test_")]
    files += [*ROOT.glob("scenarios/*.toml"), *ROOT.glob("tests/**/*.toml")]
    for file in sorted(files):
        content = file.read_bytes()
        sums.update(f"{file} {len(content)}".encode() + content)
    return sums.hexdigest()[:20]


@cache
def folder():
    """Return the folder of this generation; of older ones, the latest few stay."""
    place = PLACE / digest()
    place.mkdir(parents=True, exist_ok=True)
    os.utime(place)
    for old in sorted(PLACE.iterdir(), key=os.path.getmtime)[:-GENERATIONS]:
        shutil.rmtree(old, ignore_errors=True)  # another worker may do the same
    return place


@contextmanager
def alone(path):
    """Nobody else is in here with the same path."""
    with path.open("w") as lock:
        if fcntl is not None:
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def kept(name, make):
    """Return the result of `make`, or what it returned under this name to the first caller."""
    short = name if len(name) < 150 else name[:80] + hashlib.sha256(name.encode()).hexdigest()
    file = folder() / (re.sub(r"[^\w=.-]", "_", short) + ".pickle")
    with alone(file.with_suffix(".lock")):
        if file.exists():
            return pickle.loads(file.read_bytes())
        result = make()
        schedule = result[1] if isinstance(result, tuple) else result
        if not getattr(schedule, "safety", schedule).cut_by_clock:  # a slow moment is not left to quick ones
            temporary = file.with_suffix(f".{os.getpid()}")
            temporary.write_bytes(pickle.dumps(result))
            temporary.replace(file)
    return result


@cache
def scheduled(name, *overrides):
    """(scenario, schedule) of a bundled scenario, with overrides."""

    def make():
        scenario = load_scenario(name, [*overrides])
        return scenario, synthesize(scenario)

    return kept("-".join([name, *overrides]), make)


@cache
def printed(name, *overrides):
    """Return `scheduled` by the printed algorithms alone: U along one reference planned without it."""

    def make():
        scenario = load_scenario(name, ["recoverable.recourse=none", *overrides])
        return scenario, synthesize(scenario)

    return kept("-".join(["printed", name, *overrides]), make)
