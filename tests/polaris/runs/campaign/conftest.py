"""One campaign flown in this process, that others are compared with."""

import shutil

import pytest

from tests.polaris.runs.campaign.scene import fly


@pytest.fixture(scope="session")
def flown(tmp_path_factory):
    return fly(tmp_path_factory.mktemp("campaign") / "here")


@pytest.fixture
def copied(flown, tmp_path):
    """Its folder once more, for tests that damage it."""
    return shutil.copytree(flown.path, tmp_path / "c")
