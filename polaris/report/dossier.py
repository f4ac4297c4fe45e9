"""The dossier of a run: clause by clause what its files answer, on at most twelve pages for print."""

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from textwrap import wrap
from typing import Any

from ..certificate.checker import verify
from ..certificate.kernel.verdict import VERIFIED, Verdict
from ..model.errors import ScenarioError
from ..runs.files.atomic import adding, check_file, replacing_file
from ..runs.files.folder import RunFolder, readable
from ..runs.files.ownership import sha256
from ..runs.files.tables import besides
from ..runs.run import read_run
from .clauses import CLAUSES, Clause, Evidence
from .sentences import goal, reach
from .tables import Measure, value_cell

MOST_PAGES = 12
PAGE = (8.27, 11.69)  # A4 [in]
LINES, COLUMNS = 76, 112  # of a page, in its smallest type
LONGEST = 240  # characters of one answer: texts come from files that others may have written
HEADS = "#0072B2"  # colour of headings: the light font has no bold letters
ABSENT = "not asked for in this run"
UNPROVEN = "not proven"


@dataclass(frozen=True)
class Line:
    """A line of a page: its text, whether it is a heading, and whether the next line belongs to it."""

    text: str
    head: bool = False
    with_next: bool = False


@dataclass(frozen=True)
class Dossier:
    """Contents of the dossier of a run: its folder, files by name, and the checker's verdict."""

    run: RunFolder
    verdict: Verdict
    files: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, run: RunFolder) -> "Dossier":
        """Read the files of a run folder of a schedule, and let the checker judge it."""
        if run.kind.name != "schedule":
            raise ScenarioError("report", str(run.path), "is no run of a schedule: it has no dossier")
        scenario = tomllib.loads((run.path / "scenario.toml").read_text(encoding="utf-8"))
        return cls(run, verify(run.path), {"summary.json": run.summary, "scenario.toml": scenario})

    @property
    def proven(self) -> bool:
        """True if the run claims a proof and the independent checker confirms it."""
        return (
            self.files["summary.json"]["guarantee"]["kind"] == "proved" and self.verdict.outcome == VERIFIED
        )

    def answer(self, evidence: Evidence) -> str:
        """Return what the run says: a value of its files with its unit, or a sentence of its guarantee."""
        file, _, path = evidence.address.partition(": ")
        if file == "check":
            return self.verdict.outcome if path == "outcome" else sha256(self.run.path / "certificate.json")
        if file == "claim":
            texts = [text for head, text in self._claims() if head == path]
            return (" ".join(texts) or ABSENT) if self.proven else UNPROVEN
        value, keys = self.files[file], path.split(".")
        for key in keys:
            if isinstance(value, list):
                value = [part.get(key) for part in value if isinstance(part, dict)]
            else:
                value = value.get(key) if isinstance(value, dict) else None
        if value is None or value == []:
            known = path.startswith("polaris.") and isinstance(self.files[file].get("polaris"), dict)
            return value_cell(None, keys[-1]).text if known else ABSENT
        return _plain(Measure.of(keys[-1]).text(value) if isinstance(value, int | float) else _listed(value))

    def _claims(self) -> list[tuple[str, str]]:
        claim = self.files["summary.json"]["guarantee"]
        return [("Safe", reach(claim)), ("Goal", goal(claim["goal"])), *besides(claim)]

    def lines(self) -> Iterator[Line]:
        """Give all lines of text, in order."""
        summary = self.files["summary.json"]
        yield Line(_plain(f"Dossier: {summary['title']}")[:COLUMNS], True)
        yield from _wrapped(
            f"Run of {summary['scenario']}, made {summary.get('created', 'at no known time')}."
        )
        yield from _wrapped(f"The independent checker says {self.verdict.outcome}.")
        if not self.proven:
            why = self.verdict.witness or "the run claims no proof"
            yield Line(_plain(f"NOTHING IS PROVEN OF THIS RUN: {why}")[:COLUMNS], True)
        yield from _wrapped(
            "Whether the mission meets a clause is its own reading of the text; here is what the run "
            "contributes, where that is found in its folder, and what only the mission can show."
        )
        for source, group in groupby(CLAUSES, lambda clause: clause.source):
            yield Line("")
            yield Line(source, True, with_next=True)
            for clause in group:
                yield from self._clause(clause)
        yield Line("")
        yield Line("What the claims rest on (summary.json: guarantee.assumptions)", True, with_next=True)
        for one in summary["guarantee"]["assumptions"]:
            yield from _wrapped(f"- {_plain(one)}")

    def _clause(self, clause: Clause) -> Iterator[Line]:
        yield Line(clause.title, True, with_next=True)
        yield from _wrapped(f"Asks: {clause.asks}" if clause.asks else "")
        for one in clause.evidence:
            yield from _wrapped(f"- {one.words}: {self.answer(one)} [{one.address}]", "    ")
        yield from _wrapped(f"Only the mission: {clause.mission}.")

    def pages(self) -> list[list[Line]]:
        """Return the lines page by page; a heading stays with what follows it."""
        pages: list[list[Line]] = [[]]
        for line in self.lines():
            room = LINES - len(pages[-1]) - 3 * line.with_next
            if room <= 0 and len(pages) < MOST_PAGES - 2:  # the figure has a page, and so has what is cut
                pages.append([])
            elif room <= 0:
                pages[-1][-1] = Line("The rest of the assumptions is in summary.json.", True)
                break
            pages[-1].append(line)
        return pages


def _plain(text: object) -> str:
    """Return a text of a file as one line of bounded length."""
    line = " ".join("".join(letter if letter.isprintable() else " " for letter in str(text)).split())
    return line if len(line) <= LONGEST else line[: LONGEST - 1] + "…"


def _listed(value: object) -> str:
    """Return a list or table of a file in words."""
    if isinstance(value, dict):
        return ", ".join(f"{key} {_listed(part)}" for key, part in value.items())
    if isinstance(value, list):
        return ", ".join(map(_listed, value))
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _wrapped(text: str, indent: str = "  ") -> Iterator[Line]:
    for i, part in enumerate(wrap(text, COLUMNS - len(indent) - 2, break_on_hyphens=False)):
        yield Line(indent + "  " * (i > 0) + part)


def write_dossier(folder: str | Path, out: str | Path | None = None, *, force: bool = False) -> Path:
    """Write the dossier of a run folder of a schedule as a PDF file of at most twelve pages.

    Parameters
    ----------
    folder : path
        A run folder of a schedule.
    out : path, optional
        The file; default ``dossier.pdf`` in the folder, where an older dossier is replaced.
    force : bool
        True if another file that is there is replaced.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    ScenarioError
        If the folder is no such run or damaged, a file of the user is there, or it cannot be written.
    """
    run = read_run(folder)
    target = None if out is None else check_file(out, endings=(".pdf",), force=force)
    with readable(run.path):
        dossier = Dossier.of(run)
        if target is not None:
            with replacing_file(target, "--out", force) as beside:
                _draw(dossier, beside)
            return target
        with adding(run.path, taken="replaced" if force else "refused") as beside:
            _draw(dossier, beside / "dossier.pdf")
    return run.path / "dossier.pdf"


def _draw(dossier: Dossier, path: Path) -> None:
    from matplotlib.backends.backend_pdf import PdfPages

    from .figures.scene import scene_figure
    from .figures.style import new_figure, printing

    texts = dossier.pages()
    with printing(), PdfPages(path, metadata={"CreationDate": None, "Title": "Dossier"}) as pdf:
        for number, lines in enumerate(texts, 1):
            figure = new_figure(PAGE[1], PAGE[0])
            figure.set_layout_engine(None)
            _write_lines(figure, lines, f"{number} of {len(texts) + 1}")
            pdf.savefig(figure)
        pdf.savefig(scene_figure(dossier.run.picture()))


def _write_lines(figure: Any, lines: Sequence[Line], footer: str) -> None:
    for i, line in enumerate(lines):
        at, size, colour = 0.96 - 0.92 * i / LINES, 8 if line.head else 7, HEADS if line.head else "black"
        figure.text(0.07, at, line.text, fontsize=size, color=colour, va="top", parse_math=False)
    figure.text(0.93, 0.02, footer, fontsize=7, ha="right")
