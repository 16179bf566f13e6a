"""Warp devices by the names that users give."""

import warp as wp

from warp_bounding.errors import DeviceError

__all__ = ["device_of"]


def device_of(name: str | wp.Device | None) -> wp.Device:
    """The Warp device of this name; the default device if ``None``.

    Raises:
        DeviceError: If this machine has none of this name.

    Example:
        >>> wb.device_of("cpu").is_cpu
        True
    """
    try:
        if name == "cuda" and not wp.get_cuda_device_count():  # Warp would print errors of the driver
            raise ValueError("no CUDA device")
        return wp.get_device(name)
    except (TypeError, ValueError, RuntimeError) as reason:
        names = [str(device) for device in wp.get_devices()]
        known = f"one of {', '.join(names)}" if len(names) > 1 else ", ".join(names)
        raise DeviceError(f"there is no such device on this machine: expected {known}, got {name!r}") from reason
