"""The dossier of a run: clause by clause what its files answer, on at most twelve pages for print."""

import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from textwrap import shorten, wrap
from typing import Any

from ..certificate.checker import verify
from ..certificate.kernel.verdict import VERIFIED, Verdict
from ..model.errors import ScenarioError
from ..runs.files.folder import RunFolder
from ..runs.files.ownership import sha256
from ..runs.files.tables import besides
from ..runs.missions.mission import MISSION
from ..synthesis.safety.recoverable import directed
from .clauses import CLAUSES, SOURCES, ZONES, Clause, Evidence
from .missions import joint_tables
from .sentences import goal, reach
from .tables import Measure, value_cell

MOST_PAGES = 12
PAGE = (8.27, 11.69)  # A4 [in]
LINES, COLUMNS = 76, 112  # of a page, in its smallest type
LONGEST = 960  # characters of one answer: texts come from files that others may have written
HEADS = "#0072B2"  # colour of headings: the light font has no bold letters
MOST_SCENES = 4  # legs of which a scene is drawn
ABSENT = "not requested in this run"
UNDECLARED = "not declared, taken as none"
ALONE = "not a mission of several legs"
UNPROVEN = "not proven"


@dataclass(frozen=True)
class Line:
    """A line of a page: its text, whether it is a heading, and whether the next line belongs to it."""

    text: str
    head: bool = False
    with_next: bool = False


@dataclass(frozen=True)
class DossierLeg:
    """A run of a schedule that a dossier is about: its name in a mission, its folder, its files by name."""

    name: str
    run: RunFolder
    files: Mapping[str, Any]

    @classmethod
    def from_run(cls, run: RunFolder, name: str = "") -> "DossierLeg":
        """Read the files of a run folder of a schedule."""
        scenario = tomllib.loads((run.path / "scenario.toml").read_text(encoding="utf-8"))
        return cls(name, run, {"summary.json": run.summary, "scenario.toml": scenario})

    @property
    def claim(self) -> Mapping[str, Any]:
        """Guarantee that the run states."""
        claim: Mapping[str, Any] = self.files["summary.json"]["guarantee"]
        return claim

    def sentence(self, head: str) -> str:
        """Return a sentence of the guarantee by its head."""
        sentences = [("Safe", reach(self.claim)), ("Goal", goal(self.claim)), *besides(self.claim)]
        return " ".join(text for name, text in sentences if name == head) or ABSENT

    def value(self, file: str, path: str) -> str:
        """Return the value of a file with its unit."""
        if path == "initial_set":
            box, names = self.run.scenario.initial_set(), self.run.scenario.system().state_names
            ends = zip(names, box.c - box.half_widths, box.c + box.half_widths, strict=True)
            return _plain(", ".join(f"{name} {a:.6g} to {b:.6g}" for name, a, b in ends) + " (m, m/s)")
        if path == ZONES:
            scenario, navigation = self.run.scenario, self.run.scenario.model.navigation
            horizon = scenario.steps, scenario.step
            boxes = navigation.kept_within(scenario.system(), horizon) if navigation else ()
            return _plain(", ".join(one.name for one in (*scenario.model.keep_in, *boxes)) or UNDECLARED)
        value, keys = self.files[file], path.split(".")
        for key in keys:
            if isinstance(value, list):
                value = [part.get(key) for part in value if isinstance(part, dict)]
            else:
                value = value.get(key) if isinstance(value, dict) else None
        if value is None or value == []:
            simulated = path.startswith("polaris.") and isinstance(self.files[file].get("polaris"), dict)
            absent = ABSENT if file == "summary.json" else UNDECLARED
            return value_cell(None, keys[-1]).text if simulated else absent
        is_number = isinstance(value, int | float)
        return _plain(Measure.from_key(keys[-1]).text(value) if is_number else _listed(value))


@dataclass(frozen=True)
class Dossier:
    """Contents of a dossier: the run folder, the checker's verdict, and the legs, one of a schedule."""

    run: RunFolder
    verdict: Verdict
    legs: Sequence[DossierLeg]

    @classmethod
    def from_run(cls, run: RunFolder, judge: Callable[[Path], Verdict] = verify) -> "Dossier":
        """Read the files of a run folder of a schedule or a mission, and let the checker judge it."""
        if run.kind is MISSION:
            pairs = zip(run.summary["mission"]["legs"], run.plot_data().legs, strict=True)
            legs = [DossierLeg.from_run(leg, entry["name"]) for entry, leg in pairs]
            return cls(run, judge(run.path), legs)
        if run.kind.name != "schedule":
            raise ScenarioError("report", str(run.path), "must be the run of a schedule or a mission")
        return cls(run, judge(run.path), [DossierLeg.from_run(run)])

    @property
    def proven(self) -> bool:
        """True if every leg claims a proof and the independent checker confirms it."""
        return self.verdict.outcome == VERIFIED and all(leg.claim["kind"] == "proved" for leg in self.legs)

    def answers(self, evidence: Evidence) -> list[str]:
        """Return the run's answers, values or sentences of the guarantee, and the legs of each."""
        file, _, path = evidence.address.partition(": ")
        if file == "check":
            return [self.verdict.outcome if path == "outcome" else sha256(self.run.path / "certificate.json")]
        if (file == "claim" or path.startswith("mission.")) and not self.proven:
            return [UNPROVEN]
        if path.startswith("mission."):
            return self._of_mission(path) if self.run.kind is MISSION else [ALONE]
        by_answer: dict[str, list[str]] = {}
        for leg in self.legs:
            text = leg.sentence(path) if file == "claim" else leg.value(file, path)
            by_answer.setdefault(text, []).append(leg.name)
        if len(by_answer) == 1:
            return list(by_answer)
        return [f"{', '.join(names)}: {text}" for text, names in by_answer.items()]

    def _of_mission(self, path: str) -> list[str]:
        if path == "mission.joints":
            tables = joint_tables(self.run.summary)
            boxes = (", ".join(f"{row[0].text} {row[-1].text}" for row in each.rows) for each in tables)
            return [f"{each.caption}: {box} (m, m/s)" for each, box in zip(tables, boxes, strict=True)]
        largest = self.run.summary["mission"]["delta_v_max_m_s"]
        return ["no bound" if largest is None else f"{directed(largest, '.4g', up=True)} m/s"]

    def lines(self) -> Iterator[Line]:
        """Give all lines of text, in order."""
        summary = self.run.summary
        yield Line(_plain(f"Dossier: {summary['title']}")[:COLUMNS], True)
        date, by = summary.get("created", "at no known time"), summary.get("versions", {}).get("polaris", "?")
        yield from _wrapped(_plain(f"Run of {summary['scenario']}, made {date} by Polaris {by}."))
        if self.run.kind is MISSION:
            names = ", ".join(leg.name for leg in self.legs)
            text = "values of a leg are in the files of its folder, which begins with its number"
            yield from _wrapped(f"Mission of {len(self.legs)} legs, {names}; {text}.")
        yield from _wrapped(f"Verdict of the independent checker: {self.verdict.outcome}.")
        if not self.proven:
            reason = self.verdict.witness or "the run claims no proof"
            yield Line(_plain(f"NOTHING IS PROVEN OF THIS RUN: {reason}")[:COLUMNS], True)
        yield from _wrapped(
            "The mission itself must judge whether it meets a clause. Each clause is followed by the values "
            "of this run, their places in its folder, and what only the mission can show."
        )
        for source, group in groupby(CLAUSES, lambda clause: clause.source):
            yield Line("")
            yield Line(source, True, with_next=True)
            yield from _wrapped(SOURCES[source])
            for clause in group:
                yield from self._clause(clause)
        yield Line("")
        yield Line("Assumptions of the claims (summary.json: guarantee.assumptions)", True, with_next=True)
        assumptions = summary["mission"]["assumptions"] if self.run.kind is MISSION else []
        by_text: dict[str, dict[str, None]] = {}
        for leg in self.legs:
            for one in leg.claim["assumptions"]:
                by_text.setdefault(one, {})[leg.name] = None
        for one in assumptions:
            yield from _wrapped(f"- {_plain(one)}")
        for one, legs in by_text.items():
            suffix = "" if len(legs) == len(self.legs) else f" [{', '.join(legs)}]"
            yield from _wrapped(f"- {_plain(one)}{suffix}")

    def _clause(self, clause: Clause) -> Iterator[Line]:
        yield Line(clause.title, True, with_next=True)
        yield from _wrapped(f"Asks: {clause.asks}" if clause.asks else "")
        for one in clause.evidence:
            answers = self.answers(one)
            if len(answers) == 1:
                yield from _wrapped(f"- {one.words}: {answers[0]} [{one.address}]", "    ")
                continue
            yield from _wrapped(f"- {one.words} [{one.address}]:", "    ")
            for text in answers:
                yield from _wrapped(text, "        ")
        yield from _wrapped(f"Only the mission: {clause.mission}.")

    @property
    def figures(self) -> int:
        """Number of pages with figures: the scenes of the first legs, and the diagrams of one."""
        return min(len(self.legs), MOST_SCENES) + 1

    def pages(self) -> list[list[Line]]:
        """Return the lines page by page; a heading stays with the text that follows."""
        pages: list[list[Line]] = [[]]
        for line in self.lines():
            lines_left = LINES - len(pages[-1]) - 3 * line.with_next
            if lines_left <= 0 and len(pages) < MOST_PAGES - self.figures:
                pages.append([])
            elif lines_left <= 0:
                pages[-1][-1] = Line("The rest is in summary.json, of a mission in those of its legs.", True)
                break
            pages[-1].append(line)
        return pages


def _plain(text: object) -> str:
    """Return a text of a file as one line of bounded length."""
    text = "".join(letter if letter.isprintable() else " " for letter in str(text))
    return shorten(text, LONGEST, placeholder=" …", break_on_hyphens=False)  # numbers stay whole


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


def draw_dossier(run: RunFolder, path: Path) -> None:
    """Write the dossier of a schedule or a mission as PDF; the checker judges the run first."""
    from matplotlib.backends.backend_pdf import PdfPages

    from .figures.scene import scene_figure
    from .figures.style import new_figure, printing
    from .figures.timelines import distance_figure

    dossier = Dossier.from_run(run)
    texts, pictures = dossier.pages(), [leg.run.plot_data() for leg in dossier.legs[:MOST_SCENES]]
    suffixes = [f" of leg {leg.name}" * bool(leg.name) for leg in dossier.legs]
    drawn = list[tuple[str, Callable[..., Any], Any]]()
    drawn += [(f"Scene{name}", scene_figure, one) for name, one in zip(suffixes, pictures, strict=False)]
    drawn.append((f"Flights{suffixes[0]} over time", distance_figure, pictures[0]))
    count = len(texts) + len(drawn)
    with printing(), PdfPages(path, metadata={"CreationDate": None, "Title": "Dossier"}) as pdf:
        for number, lines in enumerate(texts, 1):
            figure = new_figure(PAGE[1], PAGE[0])
            figure.set_layout_engine(None)
            _write_lines(figure, lines, f"{number} of {count}")
            pdf.savefig(figure)
        for number, (name, draw, picture) in enumerate(drawn, len(texts) + 1):
            figure = draw(picture)
            figure.set_layout_engine("constrained", rect=(0.05, 0.05, 0.9, 0.9))
            height = PAGE[0] / figure.get_figwidth() * figure.get_figheight()
            figure.set_size_inches(PAGE[0], min(PAGE[1], height))
            figure.text(0.05, 0.99, name, fontsize=8, color=HEADS, va="top", parse_math=False)
            figure.text(0.95, 0.01, f"{number} of {count}", fontsize=7, ha="right")
            pdf.savefig(figure)


def _write_lines(figure: Any, lines: Sequence[Line], footer: str) -> None:
    for i, line in enumerate(lines):
        y, size, colour = 0.96 - 0.92 * i / LINES, 9 if line.head else 8.3, HEADS if line.head else "black"
        figure.text(0.06, y, line.text, fontsize=size, color=colour, va="top", parse_math=False)
    figure.text(0.93, 0.02, footer, fontsize=7, ha="right")
