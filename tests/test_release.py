"""Releases: a wheel made of the source archive, installed in environments that have nothing else."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

pytestmark = pytest.mark.slow

OWN = f"{sys.version_info.major}.{sys.version_info.minor}"

SETS = """
import sys
import numpy as np
import reach
values = {name: getattr(reach, name) for name in reach.__all__}
A, box = np.array([[0.0, 1.0], [-1.0, 0.0]]), reach.Zonotope([0.0, 0.0], 0.1 * np.eye(2))
step, _ = reach.discretize(A, np.zeros((2, 1)), 0.1)
print(step.shape, float((box + box).support(np.array([1.0, 0.0]))))
foreign = {name.partition(".")[0] for name in sys.modules} & {"polaris", "control", "pulp", "flint"}
print("foreign:", sorted(foreign))
"""


def run(command, folder):
    """Run a command outside the repository, without the settings of this one; return what it prints."""
    settings = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    done = subprocess.run(
        [str(one) for one in command], cwd=folder, env=settings, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Build the source archive, and the wheel from it."""
    out = tmp_path_factory.mktemp("dist")
    run([sys.executable, "-m", "build", "--outdir", out, ROOT], out)
    assert len(list(out.glob("*.tar.gz"))) == 1
    (built,) = out.glob("*.whl")
    return built


def interpreter(version):
    """Find a Python of this version; skip the test where there is none."""
    if version == OWN:
        return sys.executable
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    for command in (shutil.which(f"python{version}"), *pyenv.glob(f"{version}.*/bin/python{version}")):
        runs = command and subprocess.run([command, "--version"], capture_output=True, check=False)
        if runs and not runs.returncode:
            return command
    pytest.skip(f"there is no python{version} here")


def environment(folder, *packages, version=OWN):
    """Make an environment that holds these packages, and give its interpreter."""
    run([interpreter(version), "-m", "venv", folder], folder.parent)
    python = folder / "bin" / "python"
    pip = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    run([*pip, "--constraint", ROOT / "constraints.txt", *packages], folder)
    return python


def bare(folder, wheel, *packages):
    """Make an environment that holds these packages and the wheel, without what the wheel asks for."""
    python = environment(folder, *packages)
    run([python, "-m", "pip", "install", "--quiet", "--no-deps", wheel], folder)
    return python


def test_sets_need_numpy_and_scipy_alone(wheel, tmp_path):
    python = bare(tmp_path / "env", wheel, "numpy", "scipy")
    printed = run([python, "-c", SETS], tmp_path)
    assert "(2, 2) 0.2" in printed and "foreign: []" in printed


@pytest.mark.parametrize("version", ["3.11", "3.12", "3.13"])
def test_a_wheel_runs_a_scenario_and_the_checker_needs_its_arithmetic_alone(version, wheel, tmp_path):
    python = environment(tmp_path / "env", wheel, version=version)
    small = ["--set", "simulation.runs=2", "--no-figures", "--out", tmp_path / "run"]
    assert "Guarantee: proved" in run([python.with_name("polaris"), "run", "static", *small], tmp_path)
    python = bare(tmp_path / "checker", wheel, "python-flint")
    assert "VERIFIED" in run([python, "-m", "polaris.certificate", tmp_path / "run"], tmp_path)
