"""Recoverable sets (Definition 1): from which errors the safety controller stays safe to the end.

Two kinds behind one interface: the paper's balls, corrected, and the less conservative polytopes. Both
include "S does not saturate from here to the end" (Proposition 11) and hold for the whole of every period.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal, localcontext
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from reach.sets.zonotope import Zonotope

from ...model.system import HILL_AXES, Array
from ..tracker.intersample import at_nodes
from .clearance import Clearance

THRUSTS = [f"{axis} thrust" for axis in HILL_AXES]  # inputs in newtons, as limits are called


@dataclass(frozen=True)
class Margin:
    """Margin of a set of errors inside a recoverable set, and the limit that is tightest.

    Attributes
    ----------
    value : float
        Share of the available clearance left over at the tightest place: 1 for the reference itself
        undisturbed, 0 on the boundary, negative outside.
    limit : str
        Name of the unsafe set that limits it, or of the input (`LinearSystem.input_names`).
    time : float
        Time [s] at which the limit bites, under S; for a limit beyond the settling horizon, the start of
        its step.
    tightening, clearance : float
        Tightening and clearance there, disturbance included, in m or N.
    """

    value: float
    limit: str
    time: float
    tightening: float
    clearance: float

    @property
    def inside(self) -> bool:
        """Return True if the whole set is recoverable."""
        return self.value >= 0

    def __str__(self) -> str:
        tightening = quantity(self.limit, self.tightening)
        clearance = quantity(self.limit, self.clearance, up=False)
        return f"{self.limit} at t = {self.time:.6g} s: needs {tightening}, available {clearance}"


@dataclass(frozen=True, eq=False)
class RecoverableSet(ABC):
    """One recoverable set per node, in error coordinates ``e = x - xi(t)``.

    Attributes
    ----------
    kind : str
        ``polytope`` or ``ball``.
    clearance : Clearance
        Where the reference is, and how much clearance it has.
    """

    kind: ClassVar[str]
    clearance: Clearance

    def holds(self, k: int, nodes: Zonotope, intersample: Array) -> bool:
        """Line 13 of Algorithm 2: whether the reach set over ``[t1, t2]`` is inside, pointwise in time.

        The tube over cell k is given by the sets at its q+1 nodes, and the intersample bound over the q
        parts between them.
        """
        return self.margin(k, nodes, intersample).inside

    def margin(self, k: int, nodes: Zonotope, intersample: Array) -> Margin:
        """Return the margin of a tube over cell k: at least 0 where `holds`."""
        return self.tightest(k * self.clearance.q, nodes, at_nodes(intersample))

    def margin_at(self, k: int, start: Zonotope) -> Margin:
        """Margin of one set at the start of cell k."""
        one = Zonotope(start.c[None], start.G[None])
        return self.tightest(k * self.clearance.q, one, np.zeros((1, self.clearance.tracking.system.n)))

    @abstractmethod
    def tightest(self, first: int, sets: Zonotope, intersample: Array) -> Margin:
        """Margin of a stack of sets at nodes that follow one another from `first` on.

        Elementwise, (sets, n), the intersample bound bounds the states between each node and its neighbours.
        """

    @abstractmethod
    def contains(self, node: int, errors: Array) -> NDArray[np.bool_]:
        """Return True for each error (runs, n) at a node that is recoverable."""

    @abstractmethod
    def radius(self, node: int) -> float:
        """Radius of the largest ball ``norm(W e) <= r`` inside the set at a node."""


def directed(value: float, form: str, up: bool = False) -> str:
    """Text of a proven number in a form as ``.4g``: rounded up (tightening) or down (slack)."""
    if not np.isfinite(value):
        return f"{value:{form}}"
    with localcontext() as context:
        context.rounding = ROUND_CEILING if up else ROUND_FLOOR
        text = format(Decimal(value), form)
    return f"{float(text):{form}}" if form.endswith("g") else text  # the other way of writing exponents


def quantity(margin_limit: str, value: float, up: bool = True) -> str:
    """Text of a proven number of a limit by its name, rounded up or down: in N of a thrust, in m of a set.

    Inputs of a system with a unit of its own have none.
    """
    unit = "" if margin_limit.startswith("input ") else " N" if margin_limit in THRUSTS else " m"
    return f"{directed(value, '.4g', up)}{unit}"


def slack_share(tightening: Array, clearance: Array) -> Array:
    """Share of the clearance left over, ``1 - tightening / clearance``; minus infinity without clearance.

    Rounded down: a tightening that is too small to show beside 1 still leaves less than everything.
    """
    valid = clearance > 0
    share = np.where(valid, np.nextafter(1 - tightening / np.where(valid, clearance, 1), -np.inf), -np.inf)
    return np.asarray(np.where(np.isnan(share), -np.inf, share))  # a share that is not a number is not met
