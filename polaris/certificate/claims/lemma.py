"""The bounds of Lemma 1 in ``gains.json``: no smaller than what the error does at the nodes.

``norm(R e(t)) <= gamma exp(-beta t) norm(W e(0)) + gain w_max``. No proof of safety rests on them. What is
checked is necessary: at nodes up to 64 memories of the loop for beta and gamma, and for the gain the sum of
``norm(R phi^l int_0^h e^{A s} ds D, 2)``, below which no bound by norms can be.
"""

from dataclasses import dataclass
from typing import Any

from flint import arb, arb_mat

from ..kernel.balls import identity, matrix, norms, plain, row_of
from ..kernel.motion import Motion
from ..kernel.verdict import Rejected
from ..model.loop import Memory
from ..model.lqr import positive_definite

DOUBLINGS = 6  # how often the memory of the loop is doubled to see whether the decay lasts


@dataclass(frozen=True)
class Stated:
    """Claims that the certificate itself does not make."""

    start_margin: float | None = None  # share of the room left to the initial set
    norm_bounds: dict[str, Any] | None = None  # constants of Lemma 1, see `check_norm_bounds`
    least: float | None = None  # least distance [m] of the drift after all thrust stops
    upkeep: dict[str, Any] | None = None  # what S spends for as long as it flies on
    tank: float | None = None  # velocity change that there is propellant for, by the scenario
    budget: float | None = None  # velocity change that the schedule may spend, by the scenario
    goal: tuple[dict[str, Any], dict[str, Any]] | None = None  # what is claimed of it, and the scenario's own
    orbit: dict[str, Any] | None = None  # that an abort with thrust leads to, by the scenario


def check_norm_bounds(bounds: dict[str, Any], gain: arb_mat, motion: Motion, memory: Memory) -> None:
    """Refuse a bound that the loop is certain to exceed: ``error_bounds`` of ``gains.json`` for S's gain."""
    plant = motion.plant
    m, n = gain.nrows(), gain.ncols()
    for key in ("gamma_input", "gain_input"):
        if len(bounds[key]) != m:
            raise Rejected("error_bounds", f"{key} has {len(bounds[key])} numbers for {m} inputs")
    if bounds["beta_1_s"] is None:
        return
    W, beta = matrix(bounds["weight"], n), arb(bounds["beta_1_s"])
    if not beta > 0:
        raise Rejected("error_bounds", f"the errors decay at a rate of {bounds['beta_1_s']}")
    rows = [
        ("the error", W, bounds["gamma"], bounds["gain"]),
        ("the position", plant.C, bounds["gamma_position"], bounds["gain_position"]),
        *(
            (f"input {i}", row_of(gain, i), bounds["gamma_input"][i], bounds["gain_input"][i])
            for i in range(m)
        ),
    ]
    inverse, push = W.inv(), motion.gamma * plant.D
    powers = list(enumerate(memory.powers[:-1]))
    late, last = powers[-1]
    for _ in range(DOUBLINGS):
        last, late = last * last, 2 * late
        powers.append((late, last))
    for name, R, gamma, share in rows:
        for lag, power in powers if gamma is not None else ():
            most = arb(gamma) * (-beta * plant.h * lag).exp()
            G = R * power * inverse
            spare = identity(G.nrows()) * (most * most) - G * G.transpose()
            if positive_definite(spare) is False:
                raise Rejected(
                    "error_bounds", f"gamma and beta of {name} in gains.json fail after {lag} periods"
                )
        if plant.w_max > 0 and share is not None:
            least = sum((norm_from_below(R * power * push) for power in memory.powers[:-1]), arb(0))
            if arb(share) < least:
                told = f"gain of {name} in gains.json is {share}, at least {plain(least)} is needed"
                raise Rejected("error_bounds", told, float((least - share).mid()))


def norm_from_below(G: arb_mat) -> arb:
    """A number that the 2-norm of a matrix is at least: how long some vector becomes."""
    square = G.transpose() * G
    exact = [[x.mid() for x in row] for row in square.tolist()]
    start = max(range(len(exact)), key=lambda i: float(exact[i][i]))
    x = arb_mat(len(exact), 1, [int(i == start) for i in range(len(exact))])
    for _ in range(6):
        y = (matrix(exact) * x).entries()
        size = max(abs(float(v.mid())) for v in y)
        if not size > 0:
            return arb(0)
        x = arb_mat(len(y), 1, [(v / size).mid() for v in y])
    return norms((G * x).transpose())[0] / norms(x.transpose())[0]
