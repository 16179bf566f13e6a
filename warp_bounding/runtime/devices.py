"""Warp devices by the names that users give."""

import warp as wp

from warp_bounding.errors import BoundingError, QueryError

__all__ = ["device_of"]


def device_of(name: str | wp.Device | None, error: type[BoundingError] = QueryError) -> wp.Device:
    """The Warp device of this name; the default device if ``None``.

    Raises:
        BoundingError: Of the given class, if there is none.

    Example:
        >>> wb.device_of("cpu").is_cpu
        True
    """
    try:
        return wp.get_device(name)
    except (ValueError, RuntimeError) as reason:
        names = ", ".join(str(device) for device in wp.get_devices())
        raise error(f"device must be one of {names}, got {name!r}") from reason
