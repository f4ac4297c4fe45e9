"""Outcomes of a check: verified, rejected with a witness, or not decided."""

from dataclasses import dataclass, field

VERIFIED, STATISTICAL, REJECTED, UNKNOWN = "VERIFIED", "STATISTICAL", "REJECTED", "UNKNOWN"

EXIT_CODES = {VERIFIED: 0, REJECTED: 5, UNKNOWN: 6, STATISTICAL: 7}
"""Exit codes by outcome; 2 means that there was nothing to check (no such file, python-flint missing)."""

LONGEST = 1000  # most characters of a witness: it may quote what it found


class Failed(Exception):
    """A claim, by its name in docs/certificate.md, is not confirmed: where, how, and perhaps by how much.

    The excess is in the unit that the witness names.
    """

    outcome = UNKNOWN

    def __init__(self, claim: str, witness: str, excess: float | None = None) -> None:
        super().__init__(f"{claim}: {witness}")
        self.claim, self.witness, self.excess = claim, witness[:LONGEST], excess


class Rejected(Failed):
    """It does not hold."""

    outcome = REJECTED


class Undecided(Failed):
    """The checker can neither confirm nor refute it."""


class Imprecise(Undecided):
    """Undecided claim that more bits might decide."""


@dataclass
class Record:
    """Claims confirmed so far, each with the value derived for it."""

    checked: list[tuple[str, str]] = field(default_factory=list)
    sampled: bool = False  # whether what was confirmed rests on samples
    unchecked: list[str] = field(default_factory=list)  # what the scenario demands and no check confirms

    def holds(self, claim: str, found: str) -> None:
        """Note a claim that was confirmed."""
        self.checked.append((claim, found))


@dataclass(frozen=True)
class Verdict:
    """Outcome of a check.

    Attributes
    ----------
    outcome : {"VERIFIED", "STATISTICAL", "REJECTED", "UNKNOWN"}
        ``STATISTICAL`` where all holds of flights that keep to what samples of black boxes say.
    claim, witness : str
        The claim that fails or stays open, and where; empty when verified.
    excess : float or None
        By how much it fails, in the unit that the witness names.
    checked : tuple of (str, str)
        Claims that were confirmed, each with what was found.
    trusted : tuple of str
        What the verdict rests on and no checker can confirm.
    unchecked : tuple of str
        What the scenario demands and no check confirms; no claim rests on it.
    seconds : float
        Wall time [s].
    """

    outcome: str
    claim: str = ""
    witness: str = ""
    excess: float | None = None
    checked: tuple[tuple[str, str], ...] = ()
    trusted: tuple[str, ...] = ()
    seconds: float = 0.0
    unchecked: tuple[str, ...] = ()

    @property
    def exit_code(self) -> int:
        """Exit code of the commands: 0 only if verified."""
        return EXIT_CODES[self.outcome]

    def text(self) -> str:
        """Readable report, some lines."""
        width = max((len(name) for name, _ in self.checked), default=0)
        lines = [f"{'holds':10}{name:{width}}  {text}" for name, text in self.checked]
        lines += [f"{'trusted':10}{line}" for line in self.trusted]
        lines += [f"not checked: {line}" for line in self.unchecked]
        if self.claim:
            amount = "" if self.excess is None else f", by {self.excess:.4g}"
            fails = "fails" if self.outcome == REJECTED else "open"
            lines.append(f"{fails:10}{self.claim}: {self.witness}{amount}")
        return "\n".join([*lines, f"{self.outcome} in {self.seconds:.1f} s"])
