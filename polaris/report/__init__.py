"""Interactive reports: one HTML file per run or comparison, which needs no network."""

from pathlib import Path

from ..model.errors import ScenarioError
from ..runs.atomic import check_file, write_whole
from ..runs.folder import RunFolder, readable
from ..runs.points import TRADEOFF
from ..runs.run import read_run
from .html.page import Page, page_html

__all__ = ["report_page", "write_report"]


def write_report(folder: str | Path, out: str | Path | None = None) -> Path:
    """Write the report of a run folder or of a comparison.

    Parameters
    ----------
    folder : path
        A run folder, one of the inspection problem, or a comparison.
    out : path, optional
        The file, replaced once everything is written; default ``report.html`` in the folder.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    ScenarioError
        If the folder is none of these or damaged, or the file cannot be written.
    """
    run = read_run(folder)
    if run.kind is TRADEOFF:
        rule = "is a trade-off, which is a table and a figure; give one of the run folders in it"
        raise ScenarioError("report", str(folder), rule)
    target = run.path / "report.html" if out is None else Path(out)
    check_file(target, endings=(".html", ".htm"))
    write_whole(target, page_html(report_page(run)))
    return target


def report_page(run: RunFolder) -> Page:
    """What the report of a folder says; see `write_report`."""
    from .html.comparison_report import comparison_page
    from .html.inspection_report import inspection_page
    from .html.run_report import run_page

    pages = {"comparison": comparison_page, "schedule": run_page}
    with readable(run.path):
        return pages.get(run.kind.name, inspection_page)(run)
