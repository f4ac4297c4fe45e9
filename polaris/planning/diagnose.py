"""Why there is no plan: relaxations of the problem, each naming what to relax and by how much."""

from __future__ import annotations

from typing import TYPE_CHECKING, NoReturn

from ..errors import SynthesisInfeasible

if TYPE_CHECKING:
    from .rows import Rows
    from .search import Cell
    from .solve import Planner


def unreachable(rows: Rows, deadline: float) -> NoReturn:
    raise SynthesisInfeasible("unreachable")


def blocked(planner: Planner, cells: frozenset[Cell]) -> NoReturn:
    raise SynthesisInfeasible("blocked")
