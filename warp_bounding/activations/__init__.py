"""The activations by name. A new one is a file and a line here, or is defined elsewhere and registered."""

from warp_bounding.activations.base import Activation
from warp_bounding.activations.relu import RELU
from warp_bounding.activations.sine import SINE
from warp_bounding.activations.tanh import TANH
from warp_bounding.errors import BounderError

__all__ = ["ACTIVATIONS", "DEFAULT", "SINE", "Activation", "activation_of", "register"]

ACTIVATIONS: dict[str, Activation] = {each.name: each for each in (SINE, RELU, TANH)}
DEFAULT = SINE  # activation of hidden layers; the positional encoding consists of sines whatever theirs is


def register(activation: Activation) -> None:
    """Make an activation that is defined elsewhere known by its name, to ``fit`` and ``load`` too.

    Raises:
        BounderError: If its name is taken, or cannot be a part of names in C.
    """
    if not activation.name.isidentifier() or not activation.name.isascii():
        raise BounderError(f"an activation's name must be letters, digits and underscores, got {activation.name!r}")
    if ACTIVATIONS.setdefault(activation.name, activation) is not activation:
        raise BounderError(f"there is another activation of the name {activation.name!r} already")


def activation_of(name) -> Activation:
    """The activation of a name.

    Raises:
        BounderError: If there is none of this name.
    """
    if not isinstance(name, str) or name not in ACTIVATIONS:
        raise BounderError(f"activation must be one of {', '.join(ACTIVATIONS)}, got {name!r}")
    return ACTIVATIONS[name]
