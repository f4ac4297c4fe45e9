"""Settings of the whole test run."""

import os

# Small matrices: threads only cost, and tests may run in several processes.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

from hypothesis import settings  # noqa: E402

# No deadline: how long one example takes says more about the machine than about the code.
settings.register_profile("polaris", deadline=None, print_blob=True)
settings.load_profile("polaris")
