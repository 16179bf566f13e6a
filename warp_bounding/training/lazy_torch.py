"""torch, imported at its first use: bounders that are not learned are fitted without it.

No budget counts its import.
"""

from importlib import import_module
from time import perf_counter
from typing import TYPE_CHECKING, Any

from warp_bounding.errors import BounderError
from warp_bounding.runtime.launch import compiled_for

__all__ = ["adam", "torch"]


class _Torch:
    """Stands for the module; raises ``BounderError`` at its first use if torch is not installed."""

    def __getattr__(self, name: str) -> Any:
        started = perf_counter()
        try:
            found = getattr(import_module("torch"), name)
        except ImportError as error:
            raise BounderError("fitting what is learned needs torch: pip install 'warp-bounding[train]'") from error
        compiled_for(perf_counter() - started)
        setattr(self, name, found)  # found at once from now on
        return found


if TYPE_CHECKING:
    import torch
else:
    torch = _Torch()


def adam(tensors: list, **options):
    """``torch.optim.Adam``. A process's first optimiser imports torch's compiler; no budget counts that either."""
    started = perf_counter()
    optimiser = torch.optim.Adam(tensors, **options)
    compiled_for(perf_counter() - started)
    return optimiser
