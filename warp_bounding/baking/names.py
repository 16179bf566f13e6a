"""Names of baked files: ``name-hash``, the shape's name and what it was baked from."""

import re

from warp_bounding.baking.settings import HASH_DIGITS

__all__ = ["key_parts"]

KEY = re.compile(rf"(.+)-([0-9a-f]{{{HASH_DIGITS}}})")


def key_parts(key: str) -> tuple[str, str]:
    """The name and the hash of ``name-hash``; all is name, and the hash empty, where there is none."""
    found = KEY.fullmatch(key)
    return (found[1], found[2]) if found else (key, "")
