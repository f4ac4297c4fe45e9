"""The page on assurance: every link of the trace is there, and the assumptions are those that runs carry."""

import ast
import re
from importlib import import_module
from pathlib import Path

import pytest

from polaris.certificate.assumptions import Assumptions
from polaris.report.clauses import CLAUSES

ROOT = Path(__file__).resolve().parents[3]
PAGE = (ROOT / "docs" / "assurance.md").read_text(encoding="utf-8")

PARTS = r"^### (R\d+)\n\n(?:\S.+\n)+\n- Claims: (.+)\n- Established by: (.+)\n- Tests: (.+)$"
REQUIREMENTS = {
    number: [re.findall(r"`(.+?)`", part) for part in parts]
    for number, *parts in re.findall(PARTS, re.sub(r"\n +", " ", PAGE), re.M)
}
"""Claims, what establishes a requirement, and tests, by its number."""


def functions(path):
    return {node.name for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.FunctionDef)}


def claims_of_the_checker():
    """First arguments of what confirms, refutes or leaves open a claim."""
    claims = set()
    for path in (ROOT / "polaris" / "certificate").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
                name = getattr(node.func, "attr", getattr(node.func, "id", ""))
                if name in ("holds", "Rejected", "Undecided"):
                    claims.add(node.args[0].value)
    return claims


def test_the_assumptions_are_those_that_runs_carry():
    listed = PAGE.split("## What the certificate rests on")[1].split("\n## ")[0]
    fields = {"estimate": [0.05] * 3 + [0.002] * 3, "timing": (2.0, 0.0, 0, 0.0), "carried": 0.005}
    fields |= {"thrusters": (0.0824742, 0.0377778, 0.0, 0.0), "pulses": [0.2] * 3, "allocated": True}
    fields |= {"position": [[1.0, 0.0, 0.0, 0.0], [0.0, 0.5, 0.0, -2.0]]}
    late = [("loss", 4.0), ("navigation_lost", 10.0)]
    words = Assumptions(
        1e-5, 2.0, satellites=True, horizon="one_period", until=3600.0, late=late, **fields
    ).sentences()
    assert re.findall(r"^- (.+)$", listed, re.M) == list(words)


def test_every_claim_of_the_checker_serves_a_requirement():
    served = {claim for claims, _, _ in REQUIREMENTS.values() for claim in claims}
    checked = claims_of_the_checker()
    assert len(checked) > 10
    assert checked - served - {"assumptions"} == set()
    documented = (ROOT / "docs" / "certificate.md").read_text()
    assert [claim for claim in served if f"`{claim}`" not in documented] == []


def test_requirements_are_numbered():
    assert list(REQUIREMENTS) == [f"R{i + 1}" for i in range(len(REQUIREMENTS))]
    assert len(REQUIREMENTS) == PAGE.count("\n### R") >= 9


@pytest.mark.parametrize("number", REQUIREMENTS)
def test_what_a_requirement_names_exists(number):
    _, established, tests = REQUIREMENTS[number]
    assert tests and established
    for name in established:
        module, _, attribute = name.rpartition(".")
        assert hasattr(import_module(module), attribute), name
    for test in tests:
        file, name = test.split("::")
        assert name in functions(ROOT / "tests" / file), test


def test_the_page_has_the_clauses_of_the_dossier():
    """Compare clauses in their order with the dossier."""
    rows = [f"- {one.title}" for one in CLAUSES]
    sources = {one.source for one in CLAUSES}
    practice = PAGE.split("## Practices for proximity operations")[1].split("\n## ")[0]
    section = practice.split("**French technical regulation**")[1]
    assert [row for row in section.splitlines() if row.startswith("- ")] == rows
    assert all(f"**{source}** [[" in practice for source in sources) and len(sources) == 3
    assert {"47-2", "47-5", "47-6"} <= set(re.findall(r"47-\d+", " ".join(one.title for one in CLAUSES)))
