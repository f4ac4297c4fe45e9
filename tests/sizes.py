"""Sizes of long tests: a part in `make test-slow`, everything in `make campaign`."""

import os

CAMPAIGN = bool(os.environ.get("POLARIS_CAMPAIGN"))


def fewer(whole, part):
    """Return how many seeds, runs or examples a long test takes: `part`, or `whole` in a campaign."""
    return whole if CAMPAIGN else part
