"""The reference as it is flown, and on after T as long as it takes."""

from dataclasses import replace

from flint import arb, arb_mat

from ..assumptions import claim_time
from ..files.document import Document
from ..files.entries import UnsafeSet, Vector
from ..kernel.arcs import Arc, Path
from ..kernel.balls import column, largest, magnitude, require
from ..kernel.motion import Plant
from ..kernel.verdict import Imprecise, Rejected
from ..model.craft.settling import Settling

PATH_SLACK = 1e-9
"""Largest difference between stored and exact reference, relative to its size: rounding of doubles."""

JUMP_SLACK = 2e-5
"""Largest step of the reference at T, relative to its size. It tightens limits; more is no rounding."""


def exact_path(document: Document, plant: Plant, tail: Vector) -> Path:
    """Return the exact motion under the stored inputs; after T from a state whose orbit closes exactly."""
    coasts = column(tail)
    if document.system_kind == "clohessy_wiltshire" and document.horizon == "infinite":
        coasts[4, 0] = -plant.A[3, 4] * coasts[0, 0]  # v_y = -2 eta r_x
    return Path.propagate(plant, column(document.center), document.inputs, document.steps, coasts)


def prolonged(document: Document, path: Path, settling: Settling) -> tuple[Path, list[list[int]]]:
    """Return the path and its facets; for a claim for ever, until the loop has forgotten its state at T.

    Where the tail is shorter than that, the reference coasts on as it would, past sets at rest: any
    facet will do, and the one with most clearance is taken.
    """
    doc, facets, arcs = document, list(document.facets), list(path.arcs)
    missing = doc.steps * doc.q + settling.periods - doc.cells * doc.q if doc.horizon == "infinite" else 0
    for _ in range(-(-missing // doc.q)):
        arcs.append(Arc.from_state(path.plant, arcs[-1].nodes[-1], arb_mat(len(doc.u_max), 1)))
        facets.append([_widest_facet(item, arcs[-1]) for item in doc.unsafe])
    last = arcs[-1].nodes[-1]
    if not largest(x.rad() for x in last.entries()) <= PATH_SLACK * largest(magnitude(last).entries()):
        raise Imprecise("recoverable", "precision is lost before errors at T have decayed")
    return replace(path, arcs=arcs), facets


def _widest_facet(item: UnsafeSet, arc: Arc) -> int:
    """Return the facet of a set at rest that leaves an arc most clearance."""
    rows, offsets = -item.rows(arc.plant.C), [(arb(b), arb(b)) for b in item.end[-1]]
    clearance = arc.clearance(rows, offsets)
    minima = [min(float(node[f].mid()) for node in clearance) for f in range(len(offsets))]
    return minima.index(max(minima))


def check_end(document: Document, path: Path) -> str:
    """Check that the claim on the time after T follows from the proven facts; return the confirmed claim."""
    doc, tail = document, document.cells - document.steps
    if doc.horizon == "infinite":
        _closes(doc, path, tail)
    elif doc.horizon == "one_period" and not tail:
        raise Rejected("end", "safety for one more period is claimed, but the reference ends at T")
    return claim_time(doc.horizon, doc.claim_end)


def _closes(doc: Document, path: Path, tail: int) -> None:
    """Check that the coasting motion repeats, and one turn of it lies in the tail with all sets at rest."""
    moving = [item.name for item in doc.unsafe if doc.moves(item)]
    if moving:
        raise Rejected("end", f"safety for all time is claimed, but unsafe sets move: {', '.join(moving)}")
    if any(any(u) for u in doc.inputs[doc.steps :]):
        raise Rejected("end", "the tail must coast, but has thrust")
    if doc.system_kind == "clohessy_wiltshire":
        turn = 2 * arb.pi() / arb(doc.mean_motion or 0.0)
        require("end", arb(tail) * doc.delta - turn, f"the tail has {tail} steps, less than one turn")
    else:
        rate = path.plant.A * path.arcs[doc.steps].nodes[0] if tail else column([1])
        if any(not x.is_zero() for x in rate.entries()):
            raise Rejected("end", "the reference does not come to rest exactly")
