"""What a certificate rests on and no checker can confirm, in words: one list for runs and certificates."""

from __future__ import annotations

SATELLITES = (
    "other satellites: each obeys x' = A x + D w with the same A, D and bound on w, and adds no more "
    "acceleration than is declared for it"
)
"""Assumed where there are any."""


def assumptions(
    w_max: float,
    period: float | None,
    *,
    resting: bool = True,
    satellites: bool = False,
    horizon: str = "none",
    until: float | None = None,
) -> list[str]:
    """What a certificate rests on and no checker can confirm: the one list, for runs and certificates.

    Parameters
    ----------
    w_max : float
        Bound on the disturbance.
    period : float or None
        Control period [s] of sampled feedback.
    resting : bool
        Whether any unsafe set is at rest.
    satellites : bool
        Whether any is another satellite.
    horizon : {"infinite", "one_period", "none"}
        How long safety is claimed.
    until : float or None
        Last instant of a claim of one further period [s].
    """
    if period is None:
        law = "every controller acts continuously on the exact state"
    else:
        law = f"every controller renews its input each {period:g} s, in time and with the exact state"
    ever = horizon == "infinite"
    if horizon == "none" or not (ever or until):
        fuel = "fuel: enough for every command up to T"
    else:
        end = "for ever" if ever else f"until {until:g} s"
        fuel = f"after T: the safety controller flies on {end}, and there is fuel for every command"
    rest = ["sets at rest: they stay at rest" + (" for ever" if ever else "")]
    return [
        f"model: x' = A x + B u + D w, |u_i| <= u_max, norm(w, 2) <= {w_max:g} and otherwise arbitrary",
        "initial state: inside the initial set",
        "chaser: a point, its own size being part of the unsafe sets",
        "perception: every unsafe set lies in its timed polytope",
        *(rest if resting else []),
        *([SATELLITES] if satellites else []),
        f"sampling: {law}",
        "clocks: exact; schedule, reference and unsafe sets count from the same instant",
        "experimental controllers: each obeys its declared model",
        fuel,
    ]
