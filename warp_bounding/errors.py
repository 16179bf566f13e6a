"""Exceptions of the library, each also a ``ValueError`` so that callers may catch either; and its warnings."""

import sys
import warnings

__all__ = [
    "BounderError",
    "BoundingError",
    "BoundingWarning",
    "DeviceError",
    "FileFormatError",
    "ProofError",
    "QueryError",
    "ShapeError",
]


class BoundingError(ValueError):
    """Base of all errors that bad input causes in this library.

    Example:
        >>> try:
        ...     wb.load_shape("nothing.obj")
        ... except wb.BoundingError as error:
        ...     print(error)
        nothing.obj: no such file
    """


class ShapeError(BoundingError):
    """A shape cannot be read, or there is nothing in it that can be bounded.

    Example:
        >>> wb.load_shape(np.zeros((4, 4), bool))
        Traceback (most recent call last):
        ...
        warp_bounding.errors.ShapeError: array: there is nothing to bound, all 16 cells are empty
    """


class QueryError(BoundingError):
    """A query array, a transform or a scale does not fit the bounder that it is given to.

    Example:
        >>> bounder.query(np.zeros((5, 2), np.float32))
        Traceback (most recent call last):
        ...
        warp_bounding.errors.QueryError: queries must have shape (N, 3), got (5, 2)
    """


class BounderError(BoundingError):
    """A bounder cannot be built: unknown method, impossible size, non-finite weight.

    Example:
        >>> wb.fit(ball, method="aabb", k=14)
        Traceback (most recent call last):
        ...
        warp_bounding.errors.BounderError: aabb takes no option 'k'; besides the arguments of fit, aabb takes no options
        of its own for point queries
    """


class ProofError(BounderError):
    """A proof did not end in its time, or is not expected to.

    Attributes:
        bounder: What was to be proven, without a certificate: ``proof.make_proven`` goes on with it.
        seconds: How long a proof is expected to take; infinity if that is not known.

    Example:
        >>> arm = wb.arms.Arm([wb.arms.Joint()], [wb.arms.Body.capsule([0, 0, 0], [0.5, 0, 0], 0.05, link=0)])
        >>> shape = wb.arms.ArmConfigurations(arm, [wb.arms.Body.sphere([0.5, 0, 0], 0.1)])
        >>> try:
        ...     wb.fit(shape, hidden=(8, 8), budget=0.1, device="cpu", progress=False)
        ... except wb.ProofError as error:
        ...     bounder = wb.proof.make_proven(error.bounder, shape, budget=60.0, progress=False)
    """

    def __init__(self, message: str, bounder=None, seconds: float = float("inf")):
        super().__init__(message)
        self.bounder, self.seconds = bounder, seconds


class DeviceError(BounderError, QueryError):
    """A Warp device is named that this machine does not have.

    Example:
        >>> try:
        ...     bounder.to("cuda:99")
        ... except wb.DeviceError:
        ...     print("on the CPU then")
        on the CPU then
    """


class FileFormatError(BoundingError):
    """A bounder file is damaged, truncated, foreign, edited or newer than this library.

    Example:
        >>> wb.load("nothing.safetensors")
        Traceback (most recent call last):
        ...
        warp_bounding.errors.FileFormatError: nothing.safetensors: no such file
    """


class BoundingWarning(UserWarning):
    """What was asked for was done, and is probably not what was wanted.

    Example:
        >>> import warnings
        >>> warnings.simplefilter("error", wb.BoundingWarning)  # whoever wants none of it
        >>> warnings.simplefilter("default", wb.BoundingWarning)
    """


PACKAGE = __name__.split(".")[0]


def warn(text: str) -> None:
    """Warn at the line that called the package, so that repeated warnings of one call are shown once."""
    level, frame = 2, sys._getframe(1)
    while frame.f_back and frame.f_globals.get("__name__", "").split(".")[0] == PACKAGE:
        level, frame = level + 1, frame.f_back
    warnings.warn(text, BoundingWarning, stacklevel=level)
