"""Interactive reports: one HTML file per run or comparison, which needs no network."""

from pathlib import Path

from ..model.errors import ScenarioError
from ..runs.files.atomic import adding, check_file, write_whole
from ..runs.files.folder import RunFolder, readable
from ..runs.files.tables import write_text
from ..runs.missions.mission import MISSION
from ..runs.points import TRADEOFF
from ..runs.run import read_run
from .dossier import write_dossier
from .html.page import Page, page_html

__all__ = ["report_page", "write_dossier", "write_report"]


def write_report(folder: str | Path, out: str | Path | None = None, *, force: bool = False) -> Path:
    """Write the report of a run folder or of a comparison.

    Parameters
    ----------
    folder : path
        A run folder, one of the inspection problem, or a comparison.
    out : path, optional
        The file; default ``report.html`` in the folder, where an older report is replaced.
    force : bool
        True if another file that is there is replaced.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    ScenarioError
        If the folder is none of these or damaged, a file of the user is there, or it cannot be written.
    """
    run = read_run(folder)
    if run.kind is TRADEOFF:
        rule = "is a trade-off, which is a table and a figure; give one of the run folders in it"
        raise ScenarioError("report", str(folder), rule)
    for leg in run.picture().legs if run.kind is MISSION and out is None else ():
        write_report(leg.path, force=force)
    if out is not None:
        target = check_file(out, endings=(".html", ".htm"), force=force)
        write_whole(target, page_html(report_page(run)), force=force)
        return target
    with adding(run.path, taken="replaced" if force else "refused") as beside:
        write_text(beside / "report.html", page_html(report_page(run)))
    return run.path / "report.html"


def report_page(run: RunFolder) -> Page:
    """Return the contents of the report of a folder; see `write_report`."""
    from .html.comparison_report import comparison_page
    from .html.inspection_report import inspection_page
    from .html.mission_report import mission_page
    from .html.run_report import run_page

    pages = {"comparison": comparison_page, "schedule": run_page, "mission": mission_page}
    with readable(run.path):
        return pages.get(run.kind.name, inspection_page)(run)
