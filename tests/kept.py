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
from polaris.synthesis.synthesize import synthesize

try:
    import fcntl
except ImportError:  # where files cannot be locked, two workers may make the same thing, each for itself
    fcntl = None

ROOT = Path(__file__).resolve().parents[1]
PLACE = ROOT / ".pytest_cache" / "kept"
LIBRARIES = ("numpy", "scipy", "control", "pulp", "highspy", "gurobipy", "daqp", "pydantic")
GENERATIONS = 3


@cache
def digest():
    """Of every source and scenario, of what runs them, and of this file."""
    found = hashlib.sha256(f"{sys.version} {platform.platform()} {platform.machine()}".encode())
    for name in LIBRARIES:
        try:
            found.update(f"{name} {version(name)}".encode())
        except PackageNotFoundError:
            found.update(f"no {name}".encode())
    packages = [Path(package.__file__).parent for package in (polaris, reach)]
    files = [file for package in packages for file in package.rglob("*.py")]
    for file in sorted([*files, *ROOT.glob("scenarios/*.toml"), Path(__file__)]):
        found.update(f"{file} {file.stat().st_size}".encode() + file.read_bytes())
    return found.hexdigest()[:20]


@cache
def folder():
    """Where this generation lies; of older ones, the latest few stay."""
    found = PLACE / digest()
    found.mkdir(parents=True, exist_ok=True)
    os.utime(found)
    for old in sorted(PLACE.iterdir(), key=os.path.getmtime)[:-GENERATIONS]:
        shutil.rmtree(old, ignore_errors=True)  # another worker may do the same
    return found


@contextmanager
def alone(path):
    """Nobody else is in here with the same path."""
    with path.open("w") as lock:
        if fcntl is not None:
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


@cache
def scheduled(name, *assignments):
    """(scenario, schedule) of a bundled scenario, with what is to be set in it, as ``key=value``."""
    file = folder() / (re.sub(r"[^\w=.-]", "_", "-".join([name, *assignments])) + ".pickle")
    with alone(file.with_suffix(".lock")):
        if file.exists():
            return pickle.loads(file.read_bytes())
        scenario = load_scenario(name)
        if assignments:
            scenario = scenario.with_assignments(list(assignments))
        found = scenario, synthesize(scenario)
        if not found[1].safety.cut_by_clock:  # a slow machine must not leave its schedules to a quick one
            beside = file.with_suffix(f".{os.getpid()}")
            beside.write_bytes(pickle.dumps(found))
            beside.replace(file)
    return found
