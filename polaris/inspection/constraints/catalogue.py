"""The eleven constraints of the paper and the families of barriers that keep them: names and ranks."""

from typing import NamedTuple


class Kind(NamedTuple):
    """One family of constraints: what it keeps of phi1 to phi11 (eqs. 12 to 23), of one deputy or a pair.

    The rank is what gives way last where no input satisfies all conditions: not to collide (0), not to
    collide should the thrusters fail, speeds, the zone, the sun.
    """

    phi: tuple[str, ...]
    rank: int
    pair: bool = False


KINDS = {
    "chief_separation": Kind(("phi1",), 0),
    "deputy_separation": Kind(("phi2",), 0, True),
    "speed": Kind(("phi3",), 2),
    "sun": Kind(("phi4",), 4),
    "deputy_sun": Kind(("phi5",), 4, True),
    "keep_in": Kind(("phi6",), 3),
    "passive": Kind(("phi7",), 1),
    "deputy_passive": Kind(("phi8",), 1, True),
    "velocity": Kind(("phi9", "phi10", "phi11"), 2),
}
"""By family, in the order of h1 to h11."""

FAMILIES = tuple(KINDS)

CONSTRAINTS = tuple(name for kind in KINDS.values() for name in kind.phi)  # phi1 to phi11

PASSIVE = {"phi7": "passive", "phi8": "deputy_passive"}
"""The constraints on free flights: they are their own barriers, and no part of what a backup must keep."""
