"""One campaign flown in this process, that others are compared with."""

import pytest

from tests.campaign.scene import fly


@pytest.fixture(scope="session")
def flown(tmp_path_factory):
    return fly(tmp_path_factory.mktemp("campaign") / "here")
