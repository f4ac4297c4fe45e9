"""Campaign folders: manifest, parts, cases without a schedule, summary.

=============== ====================================================================================
manifest.json   cases (whole scenarios as text), runs, seed, batch; the digest results are known by
runs/           one table per batch, one row per run
failed/         one JSON file per case that cannot be flown, with the reason
summary.json    statistics of the kind of run
=============== ====================================================================================
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from ...model.errors import NotCertified, ScenarioError
from ...model.version import version, versions
from ..atomic import check_file, check_target, replacing, replacing_file
from ..folder import read_json
from ..ownership import RESULTS, tidy_all
from ..tables import json_text, write_text
from .batch import Batch, Results
from .parts import Parts, usable
from .plan import CampaignPlan

MANIFEST = "manifest.json"


@dataclass(frozen=True)
class CampaignFolder:
    """A campaign on disk.

    Attributes
    ----------
    path : Path
    plan : CampaignPlan
    table : str
        Format of the tables, one of `FORMATS`.
    """

    path: Path
    plan: CampaignPlan
    table: str

    @property
    def parts(self) -> Parts:
        """The table of all runs."""
        return Parts(self.path / "runs", self.plan, self.table)

    @property
    def summary(self) -> dict[str, Any]:
        """Contents of ``summary.json``."""
        return read_json(self.path / "summary.json")

    def failures(self) -> dict[int, dict[str, Any]]:
        """Cases that cannot be flown, by number, with ``message`` and ``exit_code``."""
        found = {}
        for case in range(len(self.plan.cases)):
            path = self._failure(case)
            if path.is_file():
                told = read_json(path)
                if told.get("campaign") == self.plan.digest:
                    found[case] = told
        return found

    def results(self) -> Results:
        """What statistics see of it, once all parts are there."""
        plan = self.plan
        return Results(tuple(plan.cases), plan.runs, plan.seed, plan.batch, self.failures(), self.parts.read)

    def fail(self, case: int, batch: Batch) -> None:
        """Note why a case cannot be flown."""
        told = {
            "case": case,
            "label": self.plan.cases[case].label,
            "message": batch.failure,
            "exit_code": batch.code,
            "campaign": self.plan.digest,
        }
        write_beside(self._failure(case), json_text(told))

    def forget_undecided(self) -> None:
        """Drop the failures that more time might change: not certified, rather than infeasible."""
        for case, told in self.failures().items():
            if told["exit_code"] == NotCertified.exit_code:
                self._failure(case).unlink()

    def clear(self) -> None:
        """Remove what killed processes left half written."""
        for folder in (self.path, self.path / "runs", self.path / "failed"):
            tidy_all(folder)

    def write_summary(self, summary: dict[str, Any]) -> None:
        """Write ``summary.json``."""
        write_beside(self.path / "summary.json", json_text(summary))

    def _failure(self, case: int) -> Path:
        return self.path / "failed" / f"case-{case:04d}.json"


def open_campaign(out: str | Path, plan: CampaignPlan, fresh: bool = False) -> CampaignFolder:
    """Make a folder for a campaign, or take up the one that is there.

    Raises
    ------
    ScenarioError
        If there is something else, or another campaign and not `fresh`.
    """
    path = Path(out).resolve()
    table = usable(plan.kind.formats)
    if not (path / MANIFEST).is_file():
        check_target(out)
        if (path / "summary.json").is_file():
            raise ScenarioError("--out", str(out), "is a run folder; a campaign needs one of its own")
        return _new(path, plan, table)
    if fresh:
        check_target(out, campaign=True)
        _manifest(path)
        return _new(path, plan, table)
    check_file(path / "summary.json")
    known = _manifest(path)
    if known.get("digest") != plan.digest:
        rule = f"holds another campaign ({_difference(known, plan)}); --fresh replaces it"
        raise ScenarioError("--out", str(out), rule)
    if known["runs"] > plan.runs:
        rule = f"the campaign in {path} has {known['runs']} already; ask for as many or more, or --fresh"
        raise ScenarioError("--runs", plan.runs, rule)
    folder = CampaignFolder(path, plan, usable([known.get("table", table)]))
    for name in ("runs", "failed"):
        (path / name).mkdir(exist_ok=True)
    if known["runs"] < plan.runs:
        _write_manifest(path, plan, folder.table)
    folder.clear()
    folder.forget_undecided()
    return folder


def read_campaign(path: str | Path, same_version: bool = True) -> CampaignFolder:
    """Open the folder of a campaign, finished or not.

    Parameters
    ----------
    path : path
    same_version : bool
        Whether it must be of this version of the package, as for flying its runs again.

    Raises
    ------
    ScenarioError
        If it is none, is damaged, or was made by another version.
    """
    folder = Path(path)
    if not (folder / MANIFEST).is_file():
        raise ScenarioError("campaign", str(path), f"must be a campaign folder; it has no {MANIFEST}")
    known = _manifest(folder)
    if same_version and known.get("version") != version():
        rule = f"was made by version {known.get('version')}, this is {version()}: its runs may differ"
        raise ScenarioError("campaign", str(path), rule)
    try:
        plan, table = CampaignPlan.from_data(known), str(known["table"])
    except (ValueError, KeyError, TypeError, AttributeError, ScenarioError) as error:
        raise ScenarioError("campaign", str(path), f"its manifest is damaged ({error})") from error
    if same_version and plan.digest != known.get("digest"):
        raise ScenarioError("campaign", str(path), "its manifest was changed: the digest does not fit")
    return CampaignFolder(folder, plan, usable([table]))


def write_beside(path: Path, text: str) -> None:
    """Write a file: whole, or not at all."""
    with replacing_file(path) as beside:
        write_text(beside, text)


def _new(path: Path, plan: CampaignPlan, table: str) -> CampaignFolder:
    with replacing(path, RESULTS) as beside:
        for name in ("runs", "failed"):
            (beside / name).mkdir()
        _write_manifest(beside, plan, table)
    return CampaignFolder(path, plan, table)


def _write_manifest(folder: Path, plan: CampaignPlan, table: str) -> None:
    data = {
        **plan.data(),
        "digest": plan.digest,
        "table": table,
        "versions": versions(),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
    }
    write_beside(folder / MANIFEST, json_text(data))


def _manifest(folder: Path) -> dict[str, Any]:
    try:
        known = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ScenarioError("campaign", str(folder), f"its manifest is damaged ({error})") from error
    if not isinstance(known, dict) or not isinstance(known.get("runs"), int):
        raise ScenarioError("campaign", str(folder), "its manifest is damaged")
    return known


def _difference(known: dict[str, Any], plan: CampaignPlan) -> str:
    """What two campaigns differ in."""
    data = plan.data()
    names = [name for name in data if name != "runs" and known.get(name) != data[name]]
    return "other " + ", ".join(names) if names else "its manifest was changed"
