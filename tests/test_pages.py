"""Pages show what ``results`` holds."""

import pytest

pytest.importorskip("newton", reason="newton is not installed")

from measured import changed


def test_pages_are_as_measured():
    """Otherwise ``python docs/site/measured.py`` writes them anew."""
    assert not changed()
