"""What tests of the paper's tables share."""

import pytest
from fake_library import supports


@pytest.fixture
def fake_supports(monkeypatch):
    """Which bounders exist is what the fake library says."""
    monkeypatch.setattr("warp_bounding.bounders.supports", supports)
