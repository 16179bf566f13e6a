"""Where a bounder says *maybe*, as a raster; and rasters as JSON.

A raster samples the domain at the centres of even pixels, in as many dimensions as the object has. Of an animated
object it is taken at stated times. A picture shows what these points say; rates are measured elsewhere.
"""

import base64
import zlib
from typing import Any

import numpy as np

__all__ = ["pack", "pack_numbers", "packed", "raster", "unpack", "unpack_numbers"]


def raster(shape, side: int, time: float | None = None) -> np.ndarray:
    """Points on an even raster over a shape's domain.

    Args:
        shape: Has ``lower`` and ``upper``.
        side: Pixels along each axis.
        time: Of an animated shape, coordinate 0 of all points; ``None`` of others.

    Returns:
        ``(side, ..., side, n)`` float32; without an axis for time.
    """
    lower, upper = (np.asarray(x, dtype=np.float64) for x in (shape.lower, shape.upper))
    if time is not None:
        lower, upper = lower[1:], upper[1:]
    ticks = [low + (np.arange(side) + 0.5) / side * (high - low) for low, high in zip(lower, upper, strict=True)]
    points = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1)
    if time is not None:
        points = np.concatenate([np.full((*points.shape[:-1], 1), time), points], axis=-1)
    return points.astype(np.float32)


def packed(owner, points: np.ndarray) -> dict[str, Any]:
    """JSON of where a bounder says *maybe*, or where a shape is, at points ``(..., n)``."""
    flat = points.reshape(-1, points.shape[-1])
    ask = getattr(owner, "query", None)
    found = ask(flat).numpy() != 0 if ask else owner.contains(flat.astype(np.float64))
    return pack(found.reshape(points.shape[:-1]))


def pack(mask: np.ndarray) -> dict[str, Any]:
    """A mask ``(...)`` bool as JSON: its shape, and its bits, compressed, as text."""
    bits = zlib.compress(np.packbits(np.asarray(mask, dtype=bool)).tobytes(), 9)
    return {"shape": list(mask.shape), "bits": base64.b64encode(bits).decode()}


def unpack(value: dict[str, Any]) -> np.ndarray:
    """Inverse of ``pack``."""
    bits = np.frombuffer(zlib.decompress(base64.b64decode(value["bits"])), np.uint8)
    return np.unpackbits(bits, count=int(np.prod(value["shape"]))).reshape(value["shape"]).astype(bool)


def pack_numbers(values: np.ndarray) -> dict[str, Any]:
    """Numbers ``(...)`` as JSON, rounded to float16, for pictures."""
    small = np.asarray(values, dtype="<f2")
    return {"shape": list(small.shape), "float16": base64.b64encode(zlib.compress(small.tobytes(), 9)).decode()}


def unpack_numbers(value: dict[str, Any]) -> np.ndarray:
    """Inverse of ``pack_numbers``, as float64."""
    small = np.frombuffer(zlib.decompress(base64.b64decode(value["float16"])), "<f2")
    return small.reshape(value["shape"]).astype(np.float64)
