"""Newton itself, or an error that names the extra to install."""

try:
    import newton
except ImportError as error:
    raise ImportError(
        "warp_bounding.newton needs Newton: pip install 'warp-bounding[newton]'", name="newton"
    ) from error

__all__ = ["newton"]
