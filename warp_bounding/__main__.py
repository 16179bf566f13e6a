"""``python -m warp_bounding``: the same as the command ``warp-bounding``."""

from warp_bounding.cli import main

__all__: list[str] = []

if __name__ == "__main__":
    main()
