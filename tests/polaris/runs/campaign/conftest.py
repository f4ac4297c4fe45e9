"""One campaign flown in this process, that others are compared with."""

import shutil

import pytest

from polaris.runs.campaign import batch
from tests.polaris.runs.campaign.scene import fly


@pytest.fixture(scope="session")
def flown(tmp_path_factory):
    return fly(tmp_path_factory.mktemp("campaign") / "here")


@pytest.fixture
def copied(flown, tmp_path):
    """Its folder once more, for tests that damage it."""
    return shutil.copytree(flown.path, tmp_path / "c")


@pytest.fixture
def seen(monkeypatch):
    """Case and batch of the parts flown from here on."""
    parts, real = [], batch.fly_batch

    def fly_batch(task):
        parts.append((task.case, task.batch))
        return real(task)

    monkeypatch.setattr("polaris.runs.campaign.drive.fly_batch", fly_batch)
    return parts
