"""Observer in the flight code: its tables, and the rounding errors of its estimates on board."""

from dataclasses import replace
from decimal import Decimal, localcontext
from typing import NamedTuple

import numpy as np

from reach.numerics.linear import powers

from ..certificate.code.text import CENTRE, Table, Tables
from ..certificate.files.document import Document
from ..model.errors import ScenarioError
from ..model.system import Array
from ..simulation.on_board import observer_tables
from .rounding import DIGITS, MORE, UNIT, Exact, exact, held, plant

FEWEST, LONGEST = 8, 4096  # periods until an error counts as forgotten, at least and at most
LEFT = 0.01  # share of errors that is left then
ROUNDS, STEP = 50, 1.1  # most enlargements of bounds by this factor, until they hold with what they cause
FORGETS = "must be off: rounding is not forgotten by its estimates, with half of S's gain"
LOWER = 5  # times that bounds which hold are lowered to what they cause


def with_observer(tables: Tables, document: Document) -> Tables:
    """Return the tables in double precision with those of the observer that a certificate states.

    Raises
    ------
    ScenarioError
        If there is no observer, navigation may be lost, or a delay is too long.
    """
    observer = document.observer
    if observer is None:
        raise ScenarioError("observer", True, "must be off in a scenario without [navigation.measurement]")
    if any(not fault.get("pushes") for fault in document.transients):
        rule = "must be off where navigation may be lost: the bound on rounding is for fewer missed periods"
        raise ScenarioError("observer", True, rule)
    gains = [observer["gain"], *observer.get("after", ())]
    timing = document.delta / document.q, document.timing.get("delay", 0.0)
    fields = observer_tables(document.A, document.B, *timing, observer["measures"], gains, tables.range)
    return replace(tables, **fields)


class _Rounded(NamedTuple):
    """Rounding of a prediction (n,), and of an update by its kind, with the maps of an error over both."""

    predicted: Array
    updated: list[Array]
    transition: Array  # over a period, under half of S's gain: the state, then commands so far back
    force: Array  # what else commands are off by
    updates: list[Array]


def observer_rounding(document: Document, tables: Tables, precision: str, other_error: float) -> float:
    """Bound on the rounding error of any command [N], by that of all but the observer's estimate.

    The exact observer is told the exact law's commands, which differ by as much from those that are flown.
    Raises `ScenarioError` if such differences may grow.
    """
    rounded, gain = _rounded(document, tables, precision), np.array(tables.gain)
    first = float(UNIT[precision]) * np.array(tables.range) * (precision == "float")

    def commands(earlier: float) -> float:
        """Bound on errors of commands if those before were within the stated bound."""
        return other_error + _commands(rounded, gain, first, (1 - CENTRE) * (earlier + other_error))

    at_zero, slope = commands(0.0), commands(1.0)
    bound = at_zero / max(1 - (slope - at_zero), 1e-3) * MORE
    for _ in range(ROUNDS):
        if (enlarged := commands(bound) * np.sqrt(MORE)) <= bound:
            return bound
        bound = enlarged * MORE
    rule = "must be off: commands that the observer is told differ by rounding, and with S's gain these grow"
    raise ScenarioError("observer", True, rule)


def _rounded(document: Document, tables: Tables, precision: str) -> _Rounded:
    with localcontext() as context:
        context.prec = DIGITS
        u, (A, B), observer = UNIT[precision], plant(document), document.observer or {}
        input_unit = u if precision == "float" else Decimal(0)
        h, delay = Decimal(document.delta) / document.q, Decimal(document.timing.get("delay", 0.0))
        Phi, Gamma = held(A, B, h)
        C = exact(observer["measures"]) @ held(A, B, -delay)[0]
        forward = held(A, B, delay)[0]
        updates = [forward @ exact(gain) for gain in (observer["gain"], *observer.get("after", ()))]
        later = [C @ change for change in _unmeasured(A, B, h, delay, len(tables.later))]
        reach, limit, readings = (np.abs(exact(x)) for x in (tables.range, tables.limit, tables.heard))
        transition, force, C_table = (exact(x) for x in (tables.held, tables.force, tables.seen))
        size = np.abs(transition) @ reach + np.abs(force) @ limit
        predicted = np.abs(transition - Phi) @ reach + np.abs(force - Gamma) @ limit
        predicted = predicted + size * u * _terms(tables.held, tables.force)
        size = size + predicted
        innovation = readings + np.abs(C_table) @ size
        error = np.abs(C_table - C) @ size + readings * input_unit
        for table, true in zip(tables.later, later, strict=True):
            innovation = innovation + np.abs(exact(table)) @ limit
            error = error + np.abs(exact(table) - true) @ limit
        error = error + innovation * u * (1 + _terms(tables.seen, *tables.later))
        innovation, updated = innovation + error, []
        for table, true in zip(tables.updates, updates, strict=True):
            update_error = np.abs(true) @ error + np.abs(exact(table) - true) @ innovation
            update_error = update_error + (size + np.abs(exact(table)) @ innovation) * u * (1 + _terms(table))
            updated.append(update_error.astype(float))
        Phi, Gamma, C, predicted = (M.astype(float) for M in (Phi, Gamma, C, predicted))
        updates, later = ([M.astype(float) for M in table] for table in (updates, later))
        return _Rounded(predicted, updated, *_maps(Phi, Gamma, C, updates, later, np.array(tables.gain)))


def _terms(*tables: Table) -> Array:
    """Return the number of products other than 0 in every row of tables side by side."""
    return np.asarray(np.count_nonzero(np.hstack([np.array(rows) for rows in tables]), axis=1))


def _unmeasured(A: Exact, B: Exact, h: Decimal, delay: Decimal, count: int) -> list[Exact]:
    """Return the change of a state after its measurement by a command 1, 2, ... periods before."""
    changes = list[Exact]()
    for age in range(count):
        part = min(h, max(delay - age * h, Decimal(0)))
        changes.append(held(A, B, age * h)[0] @ held(A, B, part)[1])
    return changes


def _maps(
    Phi: Array, Gamma: Array, C: Array, gains: list[Array], later: list[Array], gain: Array
) -> tuple[Array, Array, list[Array]]:
    """Maps of errors of the state, and of commands so far back, over a period and by updates."""
    (n, m), count = Gamma.shape, len(later)
    size = n + count * m
    transition, force = np.eye(size, k=-m), np.zeros((size, m))
    transition[: n + m] = 0
    force[:n], force[n : n + m] = Gamma, np.eye(m)
    transition[:, :n] -= CENTRE * force @ gain
    transition[:n, :n] += Phi
    updates = []
    for each in gains:
        update = np.eye(size)
        update[:n] = np.hstack([np.eye(n) - each @ C, *(each @ part for part in later)])
        updates.append(update)
    return transition, force, updates


def _commands(rounded: _Rounded, gain: Array, first: Array, differing: float) -> float:
    """Bound on errors of commands by rounding of an estimate [N], for every pattern of missed periods.

    Commands are off by `differing` [N] besides half the law. Errors of observers are bounded by Proposition 7
    of docs/theory.md.
    """
    n, transition, force = len(first), rounded.transition, rounded.force
    steps, state = powers(transition, len(rounded.updates)), np.eye(len(transition), n)
    sizes = np.concatenate([rounded.predicted, np.full(force.shape[1], differing)])
    pushes = np.hstack([state, force]), sizes
    added, loops = list[tuple[Array, Array]](), list[Array]()
    for kind, (update, update_error) in enumerate(zip(rounded.updates, rounded.updated, strict=True), 1):
        entries = [state, *(update @ M @ pushes[0] for M in steps[:kind])]
        added.append((np.hstack(entries), np.concatenate([update_error, *[pushes[1]] * kind])))
        loops.append(update @ steps[kind])
    decays, changes, bounds = _settled(loops, added, state @ first)
    rows, worst, growth = gain @ state.T, 0.0, np.zeros(len(gain))
    for M in steps[:-1]:  # of periods without a measurement
        each = rows @ M
        peak = _worst(each @ decays, [each @ change for change in changes], added, state @ first, bounds)
        worst = max(worst, *(peak + growth).tolist())
        growth += np.abs(each @ pushes[0]) @ pushes[1]
    return worst


Added = list[tuple[Array, Array]]
"""Errors that an update adds, by its kind: ways in which they enter, and bounds on their sizes."""


def _settled(loops: list[Array], added: Added, first: Array) -> tuple[Array, list[Array], Array]:
    """Bound errors just after updates, the first within `first`; each kind turns them and adds to them.

    Before the bounds (w,) are maps of an error over so many periods, and what kinds change of it.
    """
    loop, kinds = loops[0], len(loops)
    count = FEWEST
    while True:
        decays = powers(loop, count + kinds - 1)
        changes = [decays @ (M - np.linalg.matrix_power(loop, j + 1)) for j, M in enumerate(loops)]
        bounds = _worst(decays, changes, added, first, 0 * first)
        if np.all(np.abs(decays[count:]) @ bounds <= LEFT * bounds):
            break
        if count >= LONGEST or np.abs(np.linalg.eigvals(loop)).max() >= 1:
            raise ScenarioError("observer", True, FORGETS)
        count *= 2
    for _ in range(ROUNDS):
        if np.all((updated := _worst(decays, changes, added, first, bounds)) <= bounds):
            break
        bounds = np.maximum(bounds, updated) * STEP
    else:
        raise ScenarioError("observer", True, FORGETS)
    for _ in range(LOWER):
        bounds = _worst(decays, changes, added, first, bounds)
    return decays, changes, bounds


def _worst(decays: Array, changes: list[Array], added: Added, first: Array, bounds: Array) -> Array:
    """Bound rows of errors just after updates by every pattern, if those before were within `bounds`."""
    kinds, sizes = len(added), np.abs(decays)
    count = len(decays) - kinds
    sums = np.zeros(decays.shape[:2])
    pairs = zip(added, changes, strict=True)
    terms = [np.abs(decays @ entries) @ each + np.abs(change) @ bounds for (entries, each), change in pairs]
    for age in range(count):
        for kind, each in enumerate(terms, age + 1):
            np.maximum(sums[kind], sums[age] + each[age], out=sums[kind])
    early, late = sums[:count] + sizes[:count] @ first, sums[count:] + sizes[count:] @ bounds
    return np.asarray(np.max(np.vstack([early, late]), axis=0))
