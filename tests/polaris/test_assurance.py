"""The page on assurance: generated, and every link of the trace is there."""

import ast
from importlib import import_module
from pathlib import Path

import pytest

from docs.generate.assurance_docs import PAGE, REQUIREMENTS, page_text

ROOT = Path(__file__).resolve().parents[2]


def functions(path):
    return {node.name for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.FunctionDef)}


def claims_of_the_checker():
    """First arguments of what confirms, refutes or leaves open a claim."""
    found = set()
    for path in (ROOT / "polaris" / "certificate").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
                name = getattr(node.func, "attr", getattr(node.func, "id", ""))
                if name in ("holds", "Rejected", "Undecided"):
                    found.add(node.args[0].value)
    return found


def test_the_page_is_up_to_date():
    assert (ROOT / "docs" / PAGE).read_text() == page_text(), "run: python -m docs.generate.assurance_docs"


def test_every_claim_of_the_checker_serves_a_requirement():
    served = {claim for item in REQUIREMENTS for claim in item.claims}
    found = claims_of_the_checker()
    assert len(found) > 10
    assert found - served - {"assumptions"} == set()
    documented = (ROOT / "docs" / "certificate.md").read_text()
    assert [claim for claim in served if f"`{claim}`" not in documented] == []


@pytest.mark.parametrize("item", REQUIREMENTS, ids=lambda item: item.number)
def test_what_a_requirement_names_exists(item):
    assert item.tests and item.established
    for name in item.established:
        module, attribute = name.split(":")
        assert hasattr(import_module(module), attribute)
    for test in item.tests:
        file, name = test.split("::")
        assert name in functions(ROOT / "tests" / file), test
