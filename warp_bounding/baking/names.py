"""Names of baked files: ``name-hash``, the shape's name and a hash of what it was baked from."""

import hashlib
import json
import re
from typing import Any

__all__ = ["HASH_DIGITS", "key_parts", "short_digest"]

HASH_DIGITS = 12  # hexadecimal: two of 10^5 shapes share them with a probability of 2e-5
KEY = re.compile(rf"(.+)-([0-9a-f]{{{HASH_DIGITS}}})")


def key_parts(key: str) -> tuple[str, str]:
    """The name and the hash of ``name-hash``; all is name, and the hash empty, where there is none."""
    found = KEY.fullmatch(key)
    return (found[1], found[2]) if found else (key, "")


def short_digest(value: Any) -> str:
    """``HASH_DIGITS`` hexadecimal digits of what is JSON-ready."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:HASH_DIGITS]
