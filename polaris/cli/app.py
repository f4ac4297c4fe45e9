"""The command ``polaris``: its verbs, in the order of its help.

Exit codes: 0 done, 1 fault of the program, 2 bad input, 3 no safe synthesis exists, 4 none certified
in the time given, 5 a counterexample was found, or a declared bound does not hold. Results go to standard
output, progress and errors to standard error.
"""

from . import run  # noqa: F401, I001
from . import attacks, compare, campaign, traces  # noqa: F401
from .shell import app

__all__ = ["app"]

if __name__ == "__main__":
    app()
