"""The one family of errors, each with the exit code the command line ends with; words of their messages."""

import re

_CONTROLS = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ud800-\udfff\ufeff\ufff9-\ufffb]"
)


def escape_controls(text: str) -> str:
    r"""Return a text in which control characters, but for line ends and tabs, are written as in ``\u001b``.

    Names from files may hold them: a terminal obeys them, and some reverse or hide what is shown.
    """
    return _CONTROLS.sub(lambda match: f"\\u{ord(match[0]):04x}", text)


def quoted(value: object) -> str:
    r"""Return a value as messages show it: its `repr`, backslashes once, control characters as in ``\u001b``.

    A text whose control characters are escaped already looks the same as one that holds them.
    """
    return re.sub(r"\\(\\|x(..))", lambda match: "\\" + (f"u00{match[2]}" if match[2] else ""), repr(value))


def exact(number: float) -> str:
    """Return a short text that reads back as the same number: a limit never rounds to a value it excludes."""
    short = f"{number:g}"
    return short if float(short) == number else repr(float(number))


def counted(number: int, noun: str, many: str | None = None) -> str:
    """``1 input``, ``3 inputs``; `many` where an s is not enough."""
    return f"{number} {noun if number == 1 else many or noun + 's'}"


class PolarisError(Exception):
    """Root of every error this package raises on purpose."""

    exit_code = 1

    def __str__(self) -> str:
        return escape_controls(super().__str__())


class ScenarioError(PolarisError):
    """A scenario (or an argument) is malformed: names the field, the given value, and the rule."""

    exit_code = 2

    def __init__(self, field: str, given: object, rule: str, where: str | None = None) -> None:
        self.field = field
        self.given = given
        self.rule = rule
        self.where = where
        text = "nothing" if given is None else quoted(given)
        if len(text) > 120:
            text = text[:117] + "..."
        prefix = f"{where}: " if where else ""
        super().__init__(f"{prefix}{field}: got {text}; {rule}")


class NoAnswer(ScenarioError):
    """A black box gave no answer, or none that is a command; with another it may go well."""


class SynthesisInfeasible(PolarisError):
    """No safe synthesis exists under the stated conditions.

    Attributes
    ----------
    condition : str
        The condition that fails.
    shortfall : float or None
        Amount by which it fails, in the unit named in the message.
    relax : str
        Key or value to relax to make it feasible.
    """

    exit_code = 3

    def __init__(self, condition: str, shortfall: float | None = None, relax: str = "") -> None:
        self.condition = condition
        self.shortfall = shortfall
        self.relax = relax
        super().__init__(condition + (f" To make it feasible: {relax}" if relax else ""))


class NotCertified(PolarisError):
    """No answer: nothing was found with the effort given, or the result failed its re-check."""

    exit_code = 4


class OutOfTime(NotCertified):
    """Nothing was found before the planner's wall clock ran out; with more time there may be an answer."""


def failed(message: str, exit_code: int) -> PolarisError:
    """An error of another process, or of an earlier run, by its message and its exit code."""
    error = PolarisError(message)
    error.exit_code = exit_code
    return error


class ClockWarning(UserWarning):
    """The planner's wall clock ended a search early: elsewhere, or again, the result may be another."""
