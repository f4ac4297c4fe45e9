"""Settings of the whole test run."""

import gc
import os
import sys

# Small matrices: threads only cost, and tests may run in several processes.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

# Tests are collected by several processes and start many: none of them should compile everything anew.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

import pytest  # noqa: E402
from hypothesis import settings  # noqa: E402

# No deadline: how long one example takes says more about the machine than about the code. A plain run tests
# the same examples every time, and a fifth of those that each property asks for (see below); "whole" all of
# them, as `make test-slow` does, and "search" draws new ones.
PROFILE = os.environ.get("HYPOTHESIS_PROFILE", "same")
settings.register_profile("same", deadline=None, derandomize=True)
settings.register_profile("whole", deadline=None, derandomize=True)
settings.register_profile("search", deadline=None, print_blob=True)
settings.load_profile(PROFILE)

# A plain run compiles no loops: that takes a minute anew in every checkout, and long tests fly compiled ones.
# Where a test asks for the loops all the same, they run as they stand.
if PROFILE == "same":
    os.environ.setdefault("POLARIS_COMPILED", "0")
    os.environ.setdefault("NUMBA_DISABLE_JIT", "1")

FIRST = (
    *("error_sources", "docs", "random_scenarios", "black_box", "planning", "closed_loops"),
    *("navigation", "always", "synthesis", "figures", "forged_runs", "tradeoff"),
    *("campaign", "certificate", "model_error", "corruptions", "powered_abort", "transients"),
    *("arrival", "falsify", "share_bound", "cli", "replan", "hybrid"),
    *("methods", "streams"),
)
"""Files that take longest: workers begin with them, so that none is left with one when others are done."""


def pytest_collection_finish():
    """Freeze the objects that exist before the first test, and collect garbage seldom."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000, 20, 20)


def pytest_collection_modifyitems(items):
    """Long files first; a plain run tests a fifth of the examples that each property asks for."""
    places, fewer = {f"test_{name}": place for place, name in enumerate(FIRST)}, set()
    items.sort(key=lambda item: places.get(item.path.stem, len(places)))
    for item in items:
        function = getattr(item, "obj", None)
        if not getattr(function, "is_hypothesis_test", False):
            continue
        item.add_marker(pytest.mark.property)
        if PROFILE == "same" and function not in fewer:
            fewer.add(function)
            original = function._hypothesis_internal_use_settings
            fifth = settings(original, max_examples=-(-original.max_examples // 5))
            function._hypothesis_internal_use_settings = fifth
