"""The theory page: its size, its numbered statements, and who cites them."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "theory.md").read_text(encoding="utf-8")
WORDS, STATEMENTS = 7230, 20
"""Most words of the page, formulas included, and most numbered statements."""

STATED = re.findall(r"^\*\*((?:Lemma|Proposition|Theorem) \d+) \(", PAGE, re.M)
PAPER = {"Proposition 1", "Lemma 1", "Lemma 2", "Lemma 3", "Theorem 1", "Theorem 2"}
PART = r"(?: \([a-d]\))?"
CITED = re.compile(rf"(Lemma|Proposition|Theorem)s?\s+(\d+a?{PART}(?:(?:, |,? and )\d+a?{PART})*)")


def cited(text):
    """Return the statements that a text cites by number, lists of them included."""
    text = re.sub(r"\s*\n[ \t]*(?:# ?)?", " ", text)
    matches = ((kind, re.sub(PART[3:-2], "", numbers)) for kind, numbers in CITED.findall(text))
    return {f"{kind} {number}" for kind, numbers in matches for number in re.findall(r"\d+a?", numbers)}


def docstrings(source):
    """Return the docstrings of a module, of all it defines, and of its attributes, as one text."""
    if not CITED.search(source):
        return ""
    statements = (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Expr))
    values = (node.value for node in statements if isinstance(node.value, ast.Constant))
    return "\n\n".join(value.value for value in values if isinstance(value.value, str))


def files(*folders):
    """Return the Python files in some folders, this one excepted."""
    paths = (path for folder in folders for path in sorted((ROOT / folder).rglob("*.py")))
    return [path for path in paths if path != Path(__file__)]


def cited_in(*folders):
    """Return the statements that docstrings in some folders cite."""
    return set().union(*(cited(docstrings(path.read_text(encoding="utf-8"))) for path in files(*folders)))


def test_the_page_is_short():
    assert len(PAGE.split()) <= WORDS, f"{len(PAGE.split())} words, at most {WORDS}: cut something"


def test_statements_are_few_and_numbered_in_one_sequence():
    assert len(STATED) <= STATEMENTS
    assert set(STATED) >= PAPER and len(set(STATED)) == len(STATED)
    additional = [each for each in STATED if each not in PAPER]
    assert [int(each.split()[1]) for each in additional] == list(range(3, 3 + len(additional)))


@pytest.mark.parametrize("folders", [("polaris", "reach"), ("tests",)], ids=" + ".join)
def test_every_statement_is_cited_in_docstrings(folders):
    missing = set(STATED) - cited_in(*folders)
    assert not missing, f"no docstring in {' and '.join(folders)} cites {sorted(missing)}"


def test_what_is_cited_is_stated():
    """Whatever cites a statement by its number cites one that there is."""
    pages = [*(ROOT / "docs").glob("*.md"), *(ROOT / name for name in ("README.md", "CONTRIBUTING.md"))]
    for path in [*files("polaris", "reach", "tests", "benchmarks"), *pages]:
        unknown = cited(path.read_text(encoding="utf-8")) - set(STATED)
        assert not unknown, f"{path.relative_to(ROOT)} cites {sorted(unknown)}"
