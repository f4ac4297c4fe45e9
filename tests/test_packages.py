"""Versions of packages: declared at both ends, pinned, checked, and silent on standard output."""

import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from typer.testing import CliRunner

import polaris
import polaris.inspection
import reach
from polaris.cli.app import app
from polaris.model import compiled
from reach.numerics import packages
from reach.numerics.errors import ReachError

ROOT = Path(__file__).resolve().parents[1]
EXTRAS = packages.project()["optional-dependencies"]
NEEDED = [Requirement(one) for part in (packages.project()["dependencies"], *EXTRAS.values()) for one in part]
PINS = dict(re.findall(r"^([\w.-]+)==(\S+)", (ROOT / "constraints.txt").read_text(encoding="utf-8"), re.M))


@pytest.mark.parametrize("one", NEEDED, ids=str)
def test_a_requirement_has_both_ends_and_its_pin_lies_between(one):
    operators = sorted(bound.operator for bound in one.specifier)
    assert operators in (["<", ">="], ["=="]), one
    assert operators == ["=="] or one.specifier.contains(PINS[canonicalize_name(one.name)])
    assert all(other.specifier == one.specifier for other in NEEDED if other.name == one.name)


@pytest.fixture
def install(monkeypatch):
    """Pretend that a package is installed in another version."""
    real = metadata.version

    def pretend(package, version):
        monkeypatch.setattr(metadata, "version", lambda name: version if name == package else real(name))
        packages.check.cache_clear()

    yield pretend
    packages.check.cache_clear()


@pytest.mark.parametrize("version", ["1.26.4", "99.0"])
def test_an_untested_version_is_refused_before_anything_runs(install, version):
    install("numpy", version)
    sentence = rf"numpy {re.escape(version)} is installed, but only numpy>=2\S+ is tested: pip install"
    for door in (polaris, reach, polaris.inspection):
        with pytest.raises(ReachError, match=sentence):
            door.__getattr__(door.__all__[0])
    done = CliRunner().invoke(app, ["scenarios"])
    assert (done.exit_code, done.stdout) == (2, "")
    assert re.match(rf"error: {sentence}", done.stderr) and done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("package", "extra"),
    [("onnx", "networks"), ("pyarrow", "campaign"), ("gurobipy", "gurobi"), ("numba", "fast")],
)
def test_an_optional_package_is_missing_or_untested(install, monkeypatch, package, extra):
    monkeypatch.setitem(sys.modules, package, None)
    assert packages.unusable(package) == f"needs the package {package}: pip install 'polaris-rta[{extra}]'"
    monkeypatch.setattr(packages, "find_spec", lambda name: name)
    install(package, "0.0.1")
    assert f"{package} 0.0.1 is installed, but only {package}>=" in packages.unusable(package)
    assert packages.unusable(package).endswith(f"is tested: pip install 'polaris-rta[{extra}]'")


def test_an_untested_numba_compiles_nothing(install, monkeypatch):
    monkeypatch.setattr(packages, "find_spec", lambda name: name)
    install("numba", "0.0.1")
    assert not compiled.is_enabled() and compiled.compiled(len) is len


SOLVES = """
import sys
import numpy as np
from polaris.planning import lp, backends, problem
two = np.ones(2)
for _ in range(2):
    one = lp.GrowingLP(two, 0 * two, two)
    one.add(np.ones((1, 2)), 1.0, 2.0)
    print(one.solve(10.0)[0])
import pulp
model = pulp.LpProblem("whole", pulp.LpMinimize)
x = pulp.LpVariable("x", 0.5, 5, cat="Integer")
model += x
options = problem.PlannerOptions(solver="highs")
print(backends.run(model, options, 100, 10.0, lambda *seen: "").status, x.value())
"""


@pytest.mark.parametrize("first", ["", "import highspy; highspy.Highs\n", "import os; os.close(0)\n"])
def test_solvers_print_nothing(first):
    """On the standard output of a process: C code prints there, past whatever Python puts in its place."""
    done = subprocess.run([sys.executable, "-c", first + SOLVES], cwd=ROOT, capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("1.0\n1.0\noptimal 1.0\n", "")


def test_a_closed_standard_output_stays_closed(tmp_path):
    """And what is written to a file opened since is not lost."""
    code = "import os, sys; os.close(1); from polaris.planning.lp import silent_highspy as get; get()\n"
    code += "f = open(sys.argv[1], 'w'); f.write('mine'); f.close()"
    command = [sys.executable, "-c", code, str(tmp_path / "f")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert (done.returncode, done.stderr, (tmp_path / "f").read_text()) == (0, "", "mine")
