"""Errors of the reachability library."""


class ReachError(ValueError):
    """A set or system is malformed: the message says what was given and what is required."""
