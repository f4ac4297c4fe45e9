"""Campaign folders: manifest, parts, cases without a schedule, summary.

=============== ====================================================================================
manifest.json   cases (whole scenarios as text), runs, seed, batch; the digest results are known by
runs/           one Parquet file per batch, one row per run
failed/         one JSON file per case that has no schedule, with the reason
summary.json    per case and mode: violations, means with intervals, worst runs
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
from .batch import Batch
from .parts import Parts
from .plan import Plan

MANIFEST = "manifest.json"


@dataclass(frozen=True)
class CampaignFolder:
    """A campaign on disk.

    Attributes
    ----------
    path : Path
    plan : Plan
    """

    path: Path
    plan: Plan

    @property
    def parts(self) -> Parts:
        """The table of all runs."""
        return Parts(self.path / "runs", self.plan)

    @property
    def summary(self) -> dict[str, Any]:
        """Contents of ``summary.json``."""
        return read_json(self.path / "summary.json")

    def failures(self) -> dict[int, dict[str, Any]]:
        """Cases without a schedule, by number, with ``message`` and ``exit_code``."""
        found = {}
        for case in range(len(self.plan.cases)):
            path = self._failure(case)
            if path.is_file():
                told = read_json(path)
                if told.get("campaign") == self.plan.digest:
                    found[case] = told
        return found

    def fail(self, case: int, batch: Batch) -> None:
        """Note why a case has no schedule."""
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


def open_campaign(out: str | Path, plan: Plan, fresh: bool = False) -> CampaignFolder:
    """Make a folder for a campaign, or take up the one that is there.

    Raises
    ------
    ScenarioError
        If there is something else, or another campaign and not `fresh`.
    """
    path = Path(out).resolve()
    if not (path / MANIFEST).is_file():
        check_target(out)
        if (path / "summary.json").is_file():
            raise ScenarioError("--out", str(out), "is a run folder; a campaign needs one of its own")
        return _new(path, plan)
    if fresh:
        check_target(out, campaign=True)
        _manifest(path)
        return _new(path, plan)
    check_file(path / "summary.json")
    known = _manifest(path)
    if known.get("digest") != plan.digest:
        rule = f"holds another campaign ({_difference(known, plan)}); --fresh replaces it"
        raise ScenarioError("--out", str(out), rule)
    if known["runs"] > plan.runs:
        rule = f"the campaign in {path} has {known['runs']} already; ask for as many or more, or --fresh"
        raise ScenarioError("--runs", plan.runs, rule)
    folder = CampaignFolder(path, plan)
    for name in ("runs", "failed"):
        (path / name).mkdir(exist_ok=True)
    if known["runs"] < plan.runs:
        _write_manifest(path, plan)
    folder.clear()
    folder.forget_undecided()
    return folder


def read_campaign(path: str | Path) -> CampaignFolder:
    """Open the folder of a campaign, finished or not.

    Raises
    ------
    ScenarioError
        If it is none, is damaged, or was made by another version.
    """
    folder = Path(path)
    if not (folder / MANIFEST).is_file():
        raise ScenarioError("campaign", str(path), f"must be a campaign folder; it has no {MANIFEST}")
    known = _manifest(folder)
    if known.get("version") != version():
        rule = f"was made by version {known.get('version')}, this is {version()}: its runs may differ"
        raise ScenarioError("campaign", str(path), rule)
    try:
        plan = Plan.from_data(known)
    except (ValueError, KeyError, TypeError, AttributeError, ScenarioError) as error:
        raise ScenarioError("campaign", str(path), f"its manifest is damaged ({error})") from error
    if plan.digest != known.get("digest"):
        raise ScenarioError("campaign", str(path), "its manifest was changed: the digest does not fit")
    return CampaignFolder(folder, plan)


def write_beside(path: Path, text: str) -> None:
    """Write a file: whole, or not at all."""
    with replacing_file(path) as beside:
        write_text(beside, text)


def _new(path: Path, plan: Plan) -> CampaignFolder:
    with replacing(path, RESULTS) as beside:
        for name in ("runs", "failed"):
            (beside / name).mkdir()
        _write_manifest(beside, plan)
    return CampaignFolder(path, plan)


def _write_manifest(folder: Path, plan: Plan) -> None:
    data = {
        **plan.data(),
        "digest": plan.digest,
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


def _difference(known: dict[str, Any], plan: Plan) -> str:
    """What two campaigns differ in."""
    data = plan.data()
    names = [name for name in data if name != "runs" and known.get(name) != data[name]]
    return "other " + ", ".join(names) if names else "its manifest was changed"
