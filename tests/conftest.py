"""Settings of the whole test run."""

import os

# Small matrices: threads only cost, and tests may run in several processes.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

from hypothesis import settings  # noqa: E402

# No deadline: how long one example takes says more about the machine than about the code. A plain run
# tests the same examples every time, and half of the usual number; HYPOTHESIS_PROFILE=search draws new ones.
settings.register_profile("same", deadline=None, derandomize=True, max_examples=50)
settings.register_profile("search", deadline=None, print_blob=True)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "same"))
