"""A proven run as C99: tables, test vectors and a self-test program beside the step function."""

from dataclasses import replace
from pathlib import Path

from ..certificate.code.selftest import selftest
from ..certificate.code.text import PRECISIONS, PREFIX, Tables, files
from ..certificate.files.document import Document
from ..model.errors import ScenarioError
from ..runs.files.atomic import check_target, replacing
from ..runs.files.tables import write_text
from ..runs.read_schedule import certificate_of, read_schedule, schedule_folder
from ..simulation.on_board import check_flyable, tables_of
from .glue import MODULE, glue_files
from .observer import observer_rounding, with_observer
from .online import with_monitor
from .rounding import as_disturbance, stated_rounding
from .vectors import FLIGHTS, calls


def export_c(
    folder: str | Path,
    out: str | Path,
    precision: str = "double",
    prefix: str | None = None,
    glue: str | None = None,
    name: str | None = None,
    module: str = MODULE,
    monitor: bool = False,
    observer: bool = False,
) -> list[Path]:
    """Write the flight code of a run folder: S, the schedule and the reference, and a self-test.

    Parameters
    ----------
    folder : path
        Run folder of a schedule that is proved.
    out : path
        Folder to write; one that holds anything but flight code is refused.
    precision : {"double", "float"}
        Type of all numbers on board.
    prefix : str, optional
        Of all external names; default ``polaris_`` and the start of the scenario's name.
    glue, name, module : str, optional
        Framework whose component or application is written beside the code, as of `glue_files`.
    monitor : bool
        Include the online monitor, which may let U fly where the schedule does not.
    observer : bool
        Include the scenario's observer: measurements are handed over instead of estimates.

    Returns
    -------
    list of Path

    Raises
    ------
    ScenarioError
        If the run is not proved, rounding takes more than the disturbance bound, an option has no such value,
        the monitor does not model the scene, or `out` cannot be written.
    """
    run = schedule_folder(folder)
    document = certificate_of(run.path)
    prefix = default_prefix(document.scenario) if prefix is None else prefix
    if precision not in PRECISIONS:
        raise ScenarioError("precision", precision, f"must be one of {', '.join(PRECISIONS)}")
    if not PREFIX.fullmatch(prefix):
        rule = "must be at most 20 of a-z, 0-9 and _, a letter first, and no header of C"
        raise ScenarioError("prefix", prefix, rule)
    if observer and (monitor or glue):
        rule = "must be off beside monitor and glue: they are for estimates that are handed over"
        raise ScenarioError("observer", True, rule)
    tables = flight_tables(document)
    tables = (with_observer(tables, document) if observer else tables).rounded(precision)
    rounding = stated_rounding(document, tables, precision)
    if observer:
        rounding = observer_rounding(document, tables, precision, rounding)
    if (share := as_disturbance(document, rounding)) >= 1:
        rule = f"rounds by {share:.3g} of the disturbance bound, which must be less than 1; use double"
        raise ScenarioError("precision", precision, rule)
    tables = replace(tables, rounding=rounding).rounded(precision)
    if monitor:
        tables = with_monitor(tables, document, read_schedule(run.path), precision)
    texts = files(tables, prefix, precision, document.digest)
    test_calls = calls(tables, FLIGHTS * (1 + monitor), 0)
    texts[f"{prefix}_selftest.c"] = selftest(tables, prefix, precision, test_calls)
    texts |= {} if glue is None else glue_files(tables, prefix, precision, glue, name, module, monitor)
    target = check_target(out, texts)
    with replacing(target) as place:
        for path, text in texts.items():
            (place / path).parent.mkdir(parents=True, exist_ok=True)
            write_text(place / path, text)
    return [target / path for path in texts]


def default_prefix(scenario: str) -> str:
    """Return a prefix made of a scenario's name."""
    letters = "".join(c if c.isascii() and c.isalnum() else "_" for c in scenario.lower())
    return f"polaris_{letters}"[:20]


def flight_tables(document: Document) -> Tables:
    """Return the tables of a proved certificate in double precision.

    Raises
    ------
    ScenarioError
        If it is not proved, or a thrust limit is 0.
    """
    check_flyable(document.guarantee, document.u_max)
    plan = document.modes, document.states, document.inputs
    gain, h, forever = document.laws[0].gain, document.delta / document.q, document.horizon != "none"
    assert gain is not None
    return tables_of(document.A, document.B, h, document.q, *plan, gain, document.u_max, forever)
