"""What samples of black boxes are said to show: the exact binomial bound, derived again."""

from typing import Any

from flint import arb

from .balls import require
from .verdict import Rejected

SLACK = 1e-9  # by how much the bound may be off its exact value, relative to it: rounding


def check_statement(said: dict[str, Any]) -> str:
    """Confirm the bound on the probability of leaving the bands, from the numbers of flights.

    Were it higher, so few flights outside would have at most the attempt's share of the doubt: a half of it
    for the first, a quarter for the second (Clopper and Pearson 1934). It trusts that they were flown.
    """
    flights, outside, attempts = said["flights"], said["outside"], said["attempts"]
    if not (0 < said["confidence"] < 1 and 0 < said["probability"] < 1 and 1 <= attempts <= 64):
        raise Rejected("samples", "probability and confidence must be between 0 and 1, attempts from 1 to 64")
    p, doubt = arb(said["probability"]) * (1 + SLACK), (1 - arb(said["confidence"])) / 2**attempts
    chance = term = (1 - p) ** flights
    for j in range(outside):
        term = term * (flights - j) / (j + 1) * p / (1 - p)
        chance += term
    told = f"{outside} of {flights} flights outside have a probability of {float(chance):.4g} at that bound"
    require("samples", doubt * (1 + SLACK) - chance, told)
    return f"{outside} of {flights} flights outside: at most {said['probability']:.4g}, attempt {attempts}"
