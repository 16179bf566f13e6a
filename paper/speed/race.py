"""Times of several bounders for the same queries, in rounds: each is asked once in every round, in turn.

A machine's speed drifts with whatever else it does. What is compared is therefore taken within a round, and the median
over rounds is what counts. Who begins moves on by one from round to round.
"""

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

__all__ = ["device_name", "devices_named", "race"]


def race(bounders: Mapping[Any, Any], queries: Any, rounds: int, heed: Callable[[], None]) -> dict[Any, np.ndarray]:
    """Seconds of every bounder in every round, by name ``(rounds,)``; before the first each has been asked once.

    Args:
        bounders: By name, all on the device of the queries.
        queries: ``(N, columns)`` float32, a Warp array.
        rounds: How many.
        heed: Called between two launches; may raise.
    """
    import warp as wp

    prepared = {name: bounder.prepare(queries) for name, bounder in bounders.items()}
    names, device = list(prepared), queries.device
    times = {name: np.zeros(rounds) for name in names}
    for each in prepared.values():  # compiled, and its memory touched
        each.launch()
    for number in range(rounds):
        first = number % len(names)
        for name in (*names[first:], *names[:first]):
            heed()
            wp.synchronize_device(device)
            start = time.perf_counter()
            prepared[name].launch()
            wp.synchronize_device(device)
            times[name][number] = time.perf_counter() - start
    return times


def devices_named(text: str | None) -> tuple[str, ...]:
    """Aliases of the Warp devices that words name; of all that are there for ``None``.

    Raises:
        DeviceError: If there is no such device.
    """
    import warp as wp

    from warp_bounding.errors import BounderError

    there = [device.alias for device in wp.get_devices()]
    words = there if text is None else [word.strip() for word in text.split(",")]
    for word in words:
        if word not in there:
            raise BounderError(f"devices must be among {', '.join(there)}, got {word!r}")
    return tuple(dict.fromkeys(words))


def device_name(alias: str) -> str:
    """What a device is, for people; of a CPU the model, where the system tells."""
    import warp as wp

    device = wp.get_device(alias)
    if not device.is_cpu:
        return device.name
    try:
        with open("/proc/cpuinfo") as file:
            models = [line.partition(":")[2].strip() for line in file if line.startswith("model name")]
    except OSError:
        models = []
    return models[0] if models else device.name
