"""Page of a mission: its legs, GO boxes, flights of all legs, and links to the pages of the legs."""

import numpy as np
from markupsafe import Markup

from ...runs.files.folder import RunFolder
from ...runs.missions.mission import MissionData
from ...synthesis.safety.recoverable import directed
from ..missions import joint_tables, legs_table, rows_flown
from ..scene.palette import mode_colour
from ..tables import Cell, Table
from .page import Page, badge, macros, reading, table
from .run_report import answers, guarantee_section


def mission_page(folder: RunFolder) -> Page:
    """Return the report of a mission."""
    summary, picture = folder.summary, folder.plot_data()
    claim, names = summary["mission"], [leg["name"] for leg in summary["mission"]["legs"]]
    delta_v = claim["delta_v_max_m_s"]
    text = "no bound" if delta_v is None else f"{directed(delta_v, '.4g', up=True)} m/s"
    safe = "every leg, and every hand-over at GO; at NO-GO the safety controller stays"
    cards = (
        ("Is it safe?", badge("proved"), safe),
        ("Does it go on?", f"{len(names)} legs", " → ".join(names)),
        ("What does it cost?", text, "at most, proven, to the planned end"),
        ("Who flies when?", f"{picture.flown.times[-1]:.6g} s", "as planned"),
    )
    lead = Markup(macros("run.html").answers(cards, _stretches(picture), f"{picture.flown.times[-1]:.6g} s"))
    joints = Markup("").join(table(each) for each in joint_tables(summary))
    flights = Table("Simulated from end to end", ["", ""], [[*map(Cell, row)] for row in rows_flown(summary)])
    sections = [("legs", "Legs", table(legs_table(summary))), ("joints", "GO or NO-GO", joints)]
    sections.append(("flights", "Flights", table(flights)))
    for name, leg in zip(names, picture.legs, strict=True):
        link = Markup('<p><a href="{0}/report.html">Interactive report of this leg</a>, in folder {0}.</p>')
        head = answers(leg.summary, leg.plot_data()) + link.format(leg.path.name)
        sections.append((f"leg-{name}", f"Leg {name}", head + guarantee_section(leg.summary["guarantee"])))
    return Page(str(summary["title"]), lead, (*sections, reading(summary)), {}, summary)


def _stretches(picture: MissionData) -> list[tuple[int, str]]:
    """Return for how many periods who flies, and the colour of the mode."""
    modes = picture.flown.modes
    cuts = np.flatnonzero(np.diff(modes)) + 1
    parts = np.split(modes, cuts)
    return [(len(part), mode_colour(int(part[0]))) for part in parts]
