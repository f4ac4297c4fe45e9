"""Printed summary of a mission."""

import shlex
from collections.abc import Mapping
from typing import Any

from ...report.missions import joint_tables, legs_table, rows_flown
from . import assume, print_line, show_cells


def show_mission(summary: Mapping[str, Any], folder: str) -> None:
    """Print legs, GO boxes, statistics of flights, and the assumptions beyond those of the legs."""
    print_line(str(summary["title"]), "bold")
    show_cells(legs_table(summary), 110)
    for cells in joint_tables(summary):
        print_line("")
        print_line(cells.caption, "bold")
        show_cells(cells)
    print_line("")
    for head, sentence in rows_flown(summary):
        print_line(f"{head}: {sentence}.")
    print_line(
        "Guarantee: proved leg by leg and at the joints. Assumptions, besides those of the legs:", "bold"
    )
    assume(summary["mission"]["assumptions"])
    print_line(f"Run folder: {folder}; one folder in it for each leg")
    print_line(f"Report: polaris report {shlex.quote(folder)}")
