"""Sizes of long tests: a part in `make test-slow`, everything in `make campaign`."""

import os

CAMPAIGN = bool(os.environ.get("POLARIS_CAMPAIGN"))


def fewer(full, part):
    """Return how many seeds, runs or examples a long test takes: `part`, or `full` in a campaign."""
    return full if CAMPAIGN else part
