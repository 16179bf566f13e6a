"""Pickling and copying of objects that cache what cannot be copied: compiled functions, and memory of a device."""

from functools import cached_property
from typing import Any

import numpy as np

__all__ = ["Picklable"]


class Picklable:
    """Pickles, and copies by ``copy.deepcopy``, without what it caches (``functools.cached_property``), which is made anew when it is needed.

    A copy has arrays of its own, read-only, because a proof is about their numbers. ``copy.copy`` shares arrays and caches.
    """

    def __getstate__(self) -> dict[str, Any]:
        own = (
            name
            for kind in type(self).__mro__
            for name, value in vars(kind).items()
            if isinstance(value, cached_property)
        )
        cached = set(own)
        return {name: value for name, value in vars(self).items() if name not in cached}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        for value in state.values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    def __copy__(self) -> Any:
        made = object.__new__(type(self))
        vars(made).update(vars(self))
        return made
