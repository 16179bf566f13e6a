"""The contract of an activation: what a hidden layer applies to its sums, and all that anybody asks of it.

An activation is one file with one object, and a line in the registry; one that is defined elsewhere is registered by
``activations.register``. Its slopes lie between -1 and 1: rounding and bounds are passed on through it undiminished.
"""

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np
import warp as wp

from warp_bounding.kernels.source import Lanes, literal

if TYPE_CHECKING:
    import torch

__all__ = ["Activation", "Curve", "constant", "constants", "polynomial"]


class Activation(ABC):
    """What a hidden layer applies to each of its sums.

    Attributes:
        name: As users and files say it, and a part of names in C.
        plain: Warp's own Python of ``statement``: a ``wp.func`` of one float.
        limit: Largest |argument| for which ``error`` holds.
        largest: Bound of |value|; where it is ``None``, |value| <= |argument|.
        bends: Whether bounds enclose it by a cubic (``curve``) rather than by a line (``relax``).
        wave: Whether training begins with steep first layers (``Recipe.first_gain``), which tell neighbouring cells
            apart.
        support_gains: Gains of the first and of later layers where a plane's supports or a region's occupancy is
            trained: initial weights are uniform in +-gain / sqrt(inputs).
        falling: Share of a monotone network's neurons that fall as the box grows: 0 for odd activations, to which
            they would add nothing.
        mean: About the mean output of a monotone network's first layer, in units of that layer's gain.
    """

    name: ClassVar[str]
    plain: ClassVar[wp.Function]
    limit: ClassVar[float] = np.inf
    largest: ClassVar[float | None] = None
    bends: ClassVar[bool] = False
    wave: ClassVar[bool] = False
    support_gains: ClassVar[tuple[float, float]] = (1.7, 1.7)
    falling: ClassVar[float] = 0.0
    mean: ClassVar[float] = 0.0

    @property
    def monotone(self) -> "Activation":
        """The activation that stands in for this one in a monotone network; itself if it never falls."""
        return self

    # --- inference, float32 ------------------------------------------------------------------------------------------

    @abstractmethod
    def statement(self, lanes: Lanes, target: str, z: str) -> str:
        """A C statement that sets ``target`` to the value at ``z``, both of type ``V``."""

    @abstractmethod
    def value32(self, z: np.ndarray) -> np.ndarray:
        """NumPy twin of ``statement``: the same float32 operations, without fused multiply-adds."""

    @abstractmethod
    def error(self, limit: float) -> float:
        """Bound of ``|computed - true value|`` for float32 arguments up to ``limit``, fused or not."""

    # --- bounds, float64 ---------------------------------------------------------------------------------------------

    @abstractmethod
    def value(self, z: np.ndarray) -> np.ndarray:
        """The value at each of an array's numbers, as exactly as their type allows."""

    def relax(self, z: np.ndarray, near: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, ...]:
        """A line with a band that holds the values at arguments ``z + l + y``; of activations that do not bend.

        The part l of an argument is linear in the coordinates of a box, all that is not linear is y.

        Args:
            z: ``(N, H)``, centres of the arguments.
            near: ``(N, H)``, ``|l| <= near``.
            noise: ``(N, H)``, ``|y| <= noise``; near and noise are not both 0.

        Returns:
            slope, mean, bend and spread, each ``(N, H)``: the value at ``z + l + y`` is ``mean + slope (l + y)`` to
            within ``spread``, and bend is 0. The caller adds what float64 rounds.
        """
        raise NotImplementedError(f"{self.name}: an activation whose `bends` is False defines `relax`")

    def curve(self, z: np.ndarray, near: np.ndarray, radius: np.ndarray, noise: np.ndarray) -> "Curve":
        """A cubic with a band that holds the values at arguments ``z + l + p + y``; of activations that bend.

        The part l of an argument is linear in the coordinates of a box, p is a quadratic form, y is all the rest.

        Args:
            z: ``(N, H)``, centres of the arguments.
            near: ``(N, H)``, ``|l| <= near``.
            radius: ``(N, H)``, ``|p| <= radius``.
            noise: ``(N, H)``, ``|y| <= noise``; not all of the three are 0.

        Returns:
            The cubic and its band; the caller adds what float64 rounds.
        """
        raise NotImplementedError(f"{self.name}: an activation whose `bends` is True defines `curve`")

    @abstractmethod
    def relaxation(self) -> str:
        """C lambdas for bounds: ``act_<name>(z)``, and ``relax_<name>(z, near, noise, slope, mean, bend, spread)``.

        Of an activation that bends, the second is ``curve_<name>(z, near, radius, noise, slope, mean, lean, bend, cube,
        cross, spread)``. They do the operations of ``value``, ``relax`` and ``curve``, in type ``V``: doubles, one a
        lane (``I`` are as many ``long long``), or on CUDA one double; ``zero`` is 0 of that type.
        """

    # --- training ----------------------------------------------------------------------------------------------------

    @abstractmethod
    def torch_value(self, z: "torch.Tensor", out: "torch.Tensor | None" = None) -> "torch.Tensor":
        """The value in torch, which autograd knows."""

    @abstractmethod
    def torch_slope(self, z: "torch.Tensor", h: "torch.Tensor", out: "torch.Tensor") -> None:
        """Write the derivative at z, where ``h`` is the value, into ``out``."""


class Curve(NamedTuple):
    """A cubic enclosure of an activation; each attribute ``(N, H)``.

    The value at ``z + l + p + y`` is ``mean + slope (l + p + y) + lean l + bend l^2 + cube l^3 + cross l p`` to within
    ``spread``.
    """

    mean: np.ndarray
    slope: np.ndarray
    lean: np.ndarray
    bend: np.ndarray
    cube: np.ndarray
    cross: np.ndarray
    spread: np.ndarray


def constant(value: float) -> str:
    """A float64 number as C text, exactly."""
    return float(value).hex()


def constants(**values: int) -> str:
    """C declaration of integer constants, by name."""
    return f"constexpr int {', '.join(f'{name} = {value}' for name, value in values.items())};"


def polynomial(coefficients: tuple[float, ...], s: str) -> str:
    """C expression of a float32 polynomial in ``s``, lowest power first, by Horner's rule."""
    text = literal(coefficients[-1])
    for c in reversed(coefficients[:-1]):
        text = f"{literal(c)} + {s} * ({text})"
    return text
