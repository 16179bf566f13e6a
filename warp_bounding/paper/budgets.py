"""Seconds for each learned fit: one number, and others for some columns or methods, as in ``20,3d=40,3d-ray:mlp=240,occupancy=5``.

What comes later goes before: of all words that name a fit's column or method, the last one counts. Presets are such texts, made
to measure every object of the paper on two cores in a stated time.
"""

import math
from typing import NamedTuple

from warp_bounding.errors import BounderError
from warp_bounding.paper.columns import LEARNED, Column, Variant, columns_named

__all__ = ["PRESETS", "Preset", "budget_of", "parse_budget"]


class Preset(NamedTuple):
    """A whole run.

    Attributes:
        budget: As ``--budget`` takes it.
        samples: Random queries that rates are measured on.
        protocol: As ``--protocol`` takes it.
    """

    budget: str
    samples: int
    protocol: str


PRESETS = {
    "full": Preset(
        "16,2d=12,2d-ray=24,2d-box=14,3d-point=20,3d-ray=50,3d-box=40,4d-point=40,4d-ray=60,4d-box=60,"
        "learned-kdop=5,relu-field=12,occupancy=6,2d-ray:mlp=60,2d-box:mlp=24,3d-box:mlp=90,3d-ray:mlp=240,4d-point:mlp=150,4d-ray:mlp=180,4d-box:mlp=120,4d-box:monotone-mlp=180",
        400_000,
        "both",
    ),
    "hour": Preset("4,3d=6,4d=12,3d-ray=13,4d-ray=16,learned-kdop=2,relu-field=4,occupancy=2", 100_000, "both"),
}


def parse_budget(text: str) -> tuple[float | None, str]:
    """Read what ``--budget`` takes.

    Returns:
        The number for all others (``None`` if there is none), and the text of the rest, as ``budget_of`` takes it.

    Raises:
        BounderError: With the word that makes no sense.
    """
    general, parts = None, []
    for word in (w.strip() for w in text.split(",")):
        name, given, seconds = word.rpartition("=")
        value, name = _seconds(seconds, word), name.strip().lower()
        if not given:
            if general is not None:
                raise BounderError(f"budget must have one number without a name, got {text!r}")
            general = value
        elif not all(columns_named(part) or part in LEARNED for part in name.split(":")):
            raise BounderError(
                f"budget must name columns (3d-ray, 3d, ray), learned methods, or both (3d-ray:mlp), got {word!r}"
            )
        else:
            parts.append(f"{name}={value:g}")
    return general, ",".join(parts)


def budget_of(column: Column, variant: Variant, general: float, budgets: str) -> float:
    """Seconds for a learned fit.

    Args:
        column: The query.
        variant: The method; a cascade takes what its last part would.
        general: Seconds where no word fits.
        budgets: As ``parse_budget`` gives it.
    """
    seconds = general
    for word in budgets.split(",") if budgets else ():
        name, _, value = word.partition("=")
        if all(part in (variant.method, variant.last) or column in columns_named(part) for part in name.split(":")):
            seconds = float(value)
    return seconds


def _seconds(text: str, word: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise BounderError(f"budget must be positive seconds, such as 60 or 20,3d-ray=60, got {word!r}")
    return value
