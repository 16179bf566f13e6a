"""What is shown with packages that the core does not need."""

from importlib import import_module
from types import ModuleType

from warp_bounding.errors import BoundingError

__all__ = ["needed"]


def needed(name: str) -> ModuleType:
    """A package of the extra ``show``.

    Raises:
        BoundingError: If it is not installed, with the extra to install.
    """
    try:
        return import_module(name)
    except ImportError as error:
        package = (error.name or name).partition(".")[0]
        raise BoundingError(f"show needs {package}: pip install 'warp-bounding[show]'") from error
