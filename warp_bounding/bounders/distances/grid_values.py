"""How a ``distance-grid`` stores its values: rounded down, in 32, 16 or 8 bits; and how they are read, natively and in Warp's own Python."""

from typing import NamedTuple

import numpy as np

from warp_bounding.arithmetic import round_down

__all__ = ["SMALLEST_HALF", "STORAGES", "Values", "decode_text"]

SMALLEST_HALF = 2.0**-14  # the least normal number of 16 bits; smaller ones are rounded down to 0, or to minus this
LEVELS = 255  # of 8 bits, above the lowest

_DECODE = {
    "float32": "[&](int i, float, float) { union { unsigned int u; float f; } x; x.u = words.data[i]; return x.f; }",
    "float16": """[&](int i, float, float) {
        const unsigned int h = words.data[i >> 1] >> (16 * (i & 1)) & 0xffffu;
        union { unsigned int u; float f; } x;
        x.u = (h & 0x8000u) << 16 | (h & 0x7fffu ? ((h & 0x7fffu) << 13) + 0x38000000u : 0u);
        return x.f;
    }""",
    "uint8": "[&](int i, float low, float step) { return low + step * (float)(words.data[i >> 2] >> (8 * (i & 3)) & 0xffu); }",
}
STORAGES = tuple(_DECODE)


class Values(NamedTuple):
    """Numbers as they are stored.

    Attributes:
        stored: ``(...)`` float32, float16 or uint8.
        meaning: ``(2,)`` float32, of 8 bits the value of 0 and the step; zeros of others.
    """

    stored: np.ndarray
    meaning: np.ndarray

    @classmethod
    def of(cls, values: np.ndarray, storage: str) -> "Values":
        """Values ``(...)`` float64, rounded down to how they are stored."""
        none = np.zeros(2, np.float32)
        if storage == STORAGES[0] or not values.size:
            return cls(round_down(values).astype(storage), none)
        if storage == STORAGES[1]:
            half = values.astype(np.float16)
            half = np.where(half.astype(np.float64) > values, np.nextafter(half, np.float16(-np.inf)), half)
            small = (half != 0) & (np.abs(half) < SMALLEST_HALF)
            return cls(np.where(small, np.where(half > 0, 0.0, -SMALLEST_HALF), half).astype(np.float16), none)
        low = np.float32(np.nextafter(round_down(values.min()), np.float32(-np.inf)))
        step = np.nextafter(np.float32((values.max() - low) / LEVELS), np.float32(np.inf))
        numbers = np.floor((values - low) / float(step) * (1 - 1e-12)).clip(0, LEVELS)
        return cls(numbers.astype(np.uint8), np.array([low, step], np.float32))

    @property
    def exact(self) -> np.ndarray:
        """``(...)`` float64, what they stand for."""
        low, step = self.meaning.astype(np.float64)
        return (
            low + step * self.stored.astype(np.float64) if self.stored.dtype == np.uint8 else self.stored.astype(float)
        )

    @property
    def subnormal(self) -> bool:
        """Whether one of 16 bits is, which is not read as it stands."""
        half = self.stored.dtype == np.float16
        return half and bool(((self.stored != 0) & (np.abs(self.exact) < SMALLEST_HALF)).any())


def decode_text(storage: str) -> str:
    """Native text of a function of a value's number among those stored, and of what 8 bits mean."""
    return _DECODE[storage]
