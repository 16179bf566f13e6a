"""Newton's kernels have no gradients in these tests: they compile in two fifths of the time."""

from contextlib import suppress

import pytest
import warp as wp

wp.config.enable_backward = False  # a module of kernels keeps what holds when it is imported
with suppress(ImportError):
    import newton.solvers  # noqa: F401
wp.config.enable_backward = True


@pytest.fixture(autouse=True)
def no_gradients(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor have those that Newton makes as it runs."""
    monkeypatch.setattr(wp.config, "enable_backward", False)
