"""Interactive reports: one HTML file per run or comparison, which needs no network."""

from pathlib import Path

from ..model.errors import ScenarioError
from ..runs.files.atomic import adding, check_file, replacing_file
from ..runs.files.folder import RunFolder, readable
from ..runs.files.tables import write_text
from ..runs.missions.mission import MISSION
from ..runs.run import read_run
from ..runs.tradeoff_points import TRADEOFF
from .dossier import draw_dossier
from .html.page import Page, page_html

__all__ = ["report_page", "write_report"]


def write_report(
    folder: str | Path, out: str | Path | None = None, *, dossier: bool = False, force: bool = False
) -> Path:
    """Write the report of a run folder or of a comparison, or the dossier of a run.

    Parameters
    ----------
    folder : path
        A run folder, one of the inspection problem, or a comparison; for a dossier one of a schedule or a
        mission.
    out : path, optional
        The file; default ``report.html`` or ``dossier.pdf`` in the folder, where an older one is replaced.
    dossier : bool
        Whether to write PDF for print instead: clause by clause what the run answers.
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
        rule = "must be a run folder; of a trade-off give one of the run folders in it"
        raise ScenarioError("report", str(folder), rule)
    name, endings = ("dossier.pdf", (".pdf",)) if dossier else ("report.html", (".html", ".htm"))
    target = None if out is None else check_file(out, endings=endings, force=force)
    for leg in run.plot_data().legs if run.kind is MISSION and target is None and not dossier else ():
        write_report(leg.path, force=force)

    def write(place: Path) -> None:
        with readable(run.path):
            draw_dossier(run, place) if dossier else write_text(place, page_html(report_page(run)))

    if target is not None:
        with replacing_file(target, "--out", force) as staging:
            write(staging)
        return target
    with adding(run.path, policy="replaced" if force else "refused") as staging:
        write(staging / name)
    return run.path / name


def report_page(run: RunFolder) -> Page:
    """Return the contents of the report of a folder; see `write_report`."""
    from .html.comparison_report import comparison_page
    from .html.inspection_report import inspection_page
    from .html.mission_report import mission_page
    from .html.run_report import run_page

    pages = {"comparison": comparison_page, "schedule": run_page, "mission": mission_page}
    with readable(run.path):
        return pages.get(run.kind.name, inspection_page)(run)
