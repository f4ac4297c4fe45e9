"""Errors of the reachability library."""


class ReachError(ValueError):
    """A set or system is malformed: the message names the given value and the requirement."""


class Unresolved(ReachError):
    """Error raised if steps, time or floating point do not suffice for a well-posed request."""


class ReachWarning(UserWarning):
    """A result is sound but of little use: the message says why, and names a remedy."""
