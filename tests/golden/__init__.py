"""Golden table: what every scene proves today, and a command that compares it with what is stored."""

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):  # before numpy reads them
    os.environ.setdefault(_name, "1")  # one thread adds up in the same order every time
