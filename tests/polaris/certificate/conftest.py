"""Tests of the checker are left out where there is no python-flint."""

from importlib.util import find_spec

collect_ignore_glob = [] if find_spec("flint") else ["test_[!a]*.py"]
