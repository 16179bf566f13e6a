"""Exceptions of the library: one small family, each also a ``ValueError`` so that callers may catch either; and its warnings."""

__all__ = ["BounderError", "BoundingError", "BoundingWarning", "FileFormatError", "IndicatorError", "QueryError"]


class BoundingError(ValueError):
    """Base of all errors that bad input causes in this library."""


class IndicatorError(BoundingError):
    """A shape cannot be read, or there is nothing in it that can be bounded."""


class QueryError(BoundingError):
    """A query array, a transform or a scale does not fit the bounder that it is given to."""


class BounderError(BoundingError):
    """A bounder cannot be built: unknown method, impossible size, non-finite weight."""


class FileFormatError(BoundingError):
    """A bounder file is damaged, truncated, foreign, edited or newer than this library."""


class BoundingWarning(UserWarning):
    """What was asked for was done, and is probably not what was wanted."""
