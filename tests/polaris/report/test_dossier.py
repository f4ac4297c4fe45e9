"""The dossier of a run: it opens, is short, says what the files say, and claims only what is checked."""

import hashlib
import json
import re
import tomllib

import matplotlib
import pytest
from typer.testing import CliRunner

from polaris.certificate.kernel.verdict import Verdict
from polaris.cli import app as cli
from polaris.model.errors import ScenarioError
from polaris.report import write_report
from polaris.report.clauses import CLAUSES
from polaris.report.dossier import ABSENT, ALONE, COLUMNS, LINES, MOST_PAGES, UNDECLARED, UNPROVEN, Dossier
from polaris.runs.run import read_run
from polaris.scenario.reading import write_toml
from tests.polaris.report.folders import EVIL, rename, rewrite_json, write_tiny


def write_dossier(folder, out=None, **options):
    return write_report(folder, out, dossier=True, **options)


@pytest.fixture
def run(tmp_path):
    return write_tiny(tmp_path / "tiny")


def text_of(pdf):
    """Text of an uncompressed PDF file, kerning put aside."""
    strings = re.findall(rb"\[(.*?)(?<!\\)\] TJ|\((.*?)(?<!\\)\) Tj", pdf, re.S)
    pieces = [b"".join(re.findall(rb"\((.*?)(?<!\\)\)", a, re.S)) if a else b for a, b in strings]
    plain = [re.sub(rb"\\(.)", rb"\1", piece, flags=re.S) for piece in pieces]
    return " ".join(" ".join(piece.decode("utf-16-be", "replace") for piece in plain).split())


def value(files, address):
    """Value at an address, read without the dossier."""
    file, path = address.split(": ")
    for key in path.split("."):
        part = files[file]
        files = {file: [one[key] for one in part] if isinstance(part, list) else part[key]}
    return files[file]


def test_it_opens_and_every_number_is_that_of_the_files(run):
    with matplotlib.rc_context({"pdf.compression": 0}):
        pdf = write_dossier(run).read_bytes()
    assert pdf.startswith(b"%PDF-") and pdf.rstrip().endswith(b"%%EOF")
    assert 2 <= len(re.findall(rb"/Type /Page\b", pdf)) <= MOST_PAGES
    text = text_of(pdf)
    files = {"summary.json": json.loads((run / "summary.json").read_text())}
    files["scenario.toml"] = tomllib.loads((run / "scenario.toml").read_text())
    compared = 0
    for clause in CLAUSES:
        assert clause.title in text
        for one in clause.evidence:
            assert one.address.split(": ")[0] in (*files, "claim", "check")
            line = next(part for part in re.split(r"\s- ", text) if part.startswith(f"{one.words}: "))
            try:
                expected = value(files, one.address)
            except (KeyError, TypeError):
                continue
            if isinstance(expected, float):
                match = re.match(r"([-\d.e]+)( %)?", line.removeprefix(f"{one.words}: "))
                scale = 100 if match[2] else 1
                real = pytest.approx(scale * expected, rel=1e-3, abs=0.05 * (scale > 1))
                assert float(match[1]) == real, line
                compared += 1
            elif isinstance(expected, int):
                assert line.startswith(f"{one.words}: {expected} "), line
                compared += 1
    assert compared >= 8
    claim = files["summary.json"]["guarantee"]
    assert all(one.split(",")[0] in text for one in claim["assumptions"])
    assert hashlib.sha256((run / "certificate.json").read_bytes()).hexdigest() in text
    assert "independent checker: VERIFIED" in text and "NOTHING IS PROVEN" not in text


def lines_of(run, verdict):
    return Dossier.from_run(read_run(run), lambda path: verdict)


def test_what_the_checker_does_not_confirm_is_not_claimed(run):
    for verdict, proven in ((Verdict("VERIFIED"), True), (Verdict("REJECTED", "digest", "no"), False)):
        dossier = lines_of(run, verdict)
        claims = [one for clause in CLAUSES for one in clause.evidence if one.address.startswith("claim: ")]
        answers = [dossier.answers(one)[0] for one in claims]
        assert all((answer == UNPROVEN) != proven for answer in answers)
        text = "\n".join(line.text for line in dossier.lines())
        assert ("NOTHING IS PROVEN OF THIS RUN: no" in text) != proven
    rewrite_json(run / "summary.json", lambda data: data["guarantee"].update(kind="none"))
    assert not lines_of(run, Verdict("VERIFIED")).proven


def test_what_a_run_does_not_have_is_said(run):
    dossier = lines_of(run, Verdict("VERIFIED"))
    answers = {one.address: dossier.answers(one)[0] for clause in CLAUSES for one in clause.evidence}
    assert answers["claim: Passive safety"] == ABSENT and answers["scenario.toml: faults.kind"] == UNDECLARED
    assert answers["summary.json: mission.joints"] == ALONE
    assert answers["claim: Safe"] != ABSENT and answers["check: outcome"] == "VERIFIED"


def with_scenario(run, scenario):
    """The dossier of a folder with another scenario, and its digest."""
    sheet, certificate = run / "scenario.toml", run / "certificate.json"
    before = hashlib.sha256(sheet.read_bytes()).hexdigest()
    sheet.write_text(write_toml(scenario))
    now = hashlib.sha256(sheet.read_bytes()).hexdigest()
    certificate.write_text(certificate.read_text().replace(before, now))
    dossier = lines_of(run, Verdict("VERIFIED"))
    return {one.words: dossier.answers(one)[0] for clause in CLAUSES for one in clause.evidence}


def test_boxes_of_navigation_are_keep_in_zones_and_its_errors_are_whole(run):
    scenario = tomllib.loads((run / "scenario.toml").read_text())
    later = [
        {"from_s": float(t), "state_error": [1.25e-6 * t, 0.002, 0.001, 0.00123456]} for t in range(1, 9)
    ]
    later[7]["within_m"] = [8.25, 6.25]
    scenario["navigation"] = {"within_m": 9.0, "state_error": [0.01, 0.01, 0.004, 0.004], "phases": later}
    answers = with_scenario(run, scenario)
    names = [zone["name"] for zone in scenario.get("keep_in", [])]
    assert answers["keep-in zones"] == ", ".join([*names, "within", "within-7"])
    errors = answers["errors of navigation"]
    assert "within_m 8.25, 6.25" in errors and errors.count("0.00123456") == 8
    later += [{"from_s": 9.0 + t / 10, "state_error": [1.25e-6] * 4} for t in range(20)]
    cut = with_scenario(run, scenario)["errors of navigation"]
    assert cut.endswith(" …") and re.fullmatch(r"[a-z_]*|[\d.]+(e-\d\d)?,", cut.split()[-2])


def test_long_texts_of_files_make_no_more_pages(run):
    rename(run, "$x_$" + EVIL * 999)
    rewrite_json(
        run / "summary.json",
        lambda data: data["guarantee"].update(assumptions=[f"{i} " + "a " * 999 for i in range(999)]),
    )
    pages = lines_of(run, Verdict("VERIFIED")).pages()
    assert len(pages) <= MOST_PAGES - 2 and all(len(page) <= LINES + 1 for page in pages)
    assert max(len(line.text) for page in pages for line in page) <= COLUMNS
    assert "The rest is in" in pages[-1][-1].text
    assert write_dossier(run, run.parent / "own.pdf").stat().st_size > 10_000


def test_files_of_the_user_stay(run, tmp_path):
    (run / "dossier.pdf").write_text("mine")
    with pytest.raises(ScenarioError, match=r"dossier\.pdf"):
        write_dossier(run)
    assert (run / "dossier.pdf").read_text() == "mine"
    assert write_dossier(run, force=True).read_bytes().startswith(b"%PDF-")
    (tmp_path / "mine.pdf").write_text("mine")
    target, command = tmp_path / "own.pdf", ["report", str(run), "--dossier", "--quiet", "--out"]
    done = CliRunner().invoke(cli.app, [*command, str(target)])
    assert done.exit_code == 0 and target.read_bytes().startswith(b"%PDF-") and not done.stdout
    with pytest.raises(ScenarioError, match="mine"):
        write_dossier(run, tmp_path / "mine.pdf")
    with pytest.raises(ScenarioError, match=r"\.pdf"):
        write_dossier(run, tmp_path / "dossier.html")
    assert (tmp_path / "mine.pdf").read_text() == "mine"
