"""The table of formats in the guide: for each row a file is made, and read, noted or refused as the row says."""

import contextlib
import re
import zlib
from pathlib import Path

import numpy as np
import pytest
from grid_cases import GRID_CASES
from mesh_cases import MESH_CASES

from warp_bounding.errors import IndicatorError

PAGE = Path(__file__).parents[3] / "docs" / "guide" / "formats.md"
ROW = re.compile(r"^\| `([a-z0-9]+/[a-z0-9-]+)` \|.*\| \*\*(read|noted|refused)\*\*")
LONGEST = 400  # characters of an error
CASES = MESH_CASES | GRID_CASES


def rows() -> list[tuple[str, str]]:
    """Keys and outcomes of all rows."""
    return [row.groups() for line in PAGE.read_text("utf-8").splitlines() if (row := ROW.match(line))]


def test_rows_and_cases_are_the_same():
    keys = [key for key, _ in rows()]
    assert len(keys) == len(set(keys))
    assert set(keys) == set(CASES)


@pytest.mark.parametrize(("key", "outcome"), rows())
def test_row(tmp_path, key, outcome):
    case = CASES[key]
    path = case.write(tmp_path)
    if outcome == "refused":
        with pytest.raises(IndicatorError) as caught:
            case.load(path)
        message = str(caught.value).replace(str(tmp_path), "")
        assert case.words
        assert case.words in message
        assert "\n" not in message
        assert len(message) < LONGEST
        return
    shape = case.load(path)
    assert (case.words != "") == (outcome == "noted")
    message = f"{shape.restriction}{getattr(shape, 'remark', '')}"
    assert case.words in message
    assert bool(message) == (outcome == "noted")
    case.check(shape)


UNCOUNTED = ("obj", "usd", "urdf", "ros", "place")  # texts that do not say how much they hold; URDF has rows of its own
CUTS = 6


@pytest.mark.parametrize(
    "key", [k for k, outcome in rows() if outcome != "refused" and k.split("/")[0] not in UNCOUNTED]
)
def test_what_is_cut_off_is_refused_or_whole(tmp_path, key):
    """Files end early, at places that differ from row to row."""
    path = CASES[key].write(tmp_path)
    whole, content, rng = CASES[key].load(path), path.read_bytes(), np.random.default_rng(zlib.crc32(key.encode()))
    for end in rng.integers(1, len(content), CUTS):
        path.write_bytes(content[:end])
        with contextlib.suppress(IndicatorError):
            assert CASES[key].load(path).digest == whole.digest
