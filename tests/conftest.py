"""Settings of the whole test run."""

import os

# Small matrices: threads only cost, and tests may run in several processes.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import pytest  # noqa: E402
from hypothesis import settings  # noqa: E402

# No deadline: how long one example takes says more about the machine than about the code. A plain run tests
# the same examples every time, and half as many as each property asks for (see below); "whole" all of them,
# as `make test-slow` does, and "search" draws new ones.
PROFILE = os.environ.get("HYPOTHESIS_PROFILE", "same")
settings.register_profile("same", deadline=None, derandomize=True)
settings.register_profile("whole", deadline=None, derandomize=True)
settings.register_profile("search", deadline=None, print_blob=True)
settings.load_profile(PROFILE)

FIRST = (
    *("test_docs", "polaris/test_error_sources", "campaign/test_campaign", "polaris/test_random_scenarios"),
    *("polaris/test_arrival", "polaris/test_figures", "polaris/test_planning", "polaris/test_closed_loops"),
    *("rta/test_runtime", "polaris/test_tradeoff", "asif/test_always", "polaris/test_forged_runs"),
    *("rta/test_methods", "polaris/test_synthesis", "polaris/test_certificate", "polaris/test_cli"),
)
"""Files that take longest: workers begin with them, so that none is left with one when others are done."""


def pytest_collection_modifyitems(items):
    """Long files first; a plain run tests half of the examples that each property asks for."""
    places, halved = {f"tests/{name}.py": place for place, name in enumerate(FIRST)}, set()
    items.sort(key=lambda item: places.get(item.nodeid.split("::")[0], len(places)))
    for item in items:
        function = getattr(item, "obj", None)
        if not getattr(function, "is_hypothesis_test", False):
            continue
        item.add_marker(pytest.mark.property)
        if PROFILE == "same" and function not in halved:
            halved.add(function)
            asked = function._hypothesis_internal_use_settings
            fewer = settings(asked, max_examples=-(-asked.max_examples // 2))
            function._hypothesis_internal_use_settings = fewer
