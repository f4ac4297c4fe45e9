"""Errors of the reachability library."""


class ReachError(ValueError):
    """A set or system is malformed: the message says what was given and what is required."""


class Unresolved(ReachError):
    """Error raised if steps, time or floating point do not suffice for a well-posed request."""


class ReachWarning(UserWarning):
    """A result is sound but of little use: the message says why, and what would help."""
