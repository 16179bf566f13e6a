"""A proof of a distance that is stopped goes on where it stopped, from a file that nothing else can pass for."""

import json
from functools import cache

import numpy as np
import pytest
import safetensors.numpy

import warp_bounding as wb
from warp_bounding.bounders.distance_grid import DistanceGrid
from warp_bounding.bounders.file_format import digest_of
from warp_bounding.errors import BounderError, FileFormatError
from warp_bounding.proof import check, distances
from warp_bounding.proof.halving import KEY


def ball(steep: float = 0.0) -> wb.shapes.Function:
    """Whose object does not tell how steep its distance is far away."""

    def distance(x):
        r = np.linalg.norm(x, axis=1)
        return r - 1 - steep * (r > 1.5)

    return wb.shapes.Function(None, [-1, -1], [1, 1], distance=distance, lipschitz=3.0)


@cache
def far() -> wb.DistanceBounder:
    """Never change it."""
    return wb.fit(ball(), "distance", "distance-grid", nodes=5, budget=1.0, device="cpu", progress=False)


@pytest.fixture(autouse=True)
def small_steps(monkeypatch, ticking):
    """Few boxes at a time, so that a small proof can be stopped in its midst; and few samples before it.

    The clock counts looks at it: how close a fit comes to the distance, and so how long its proof is, is the same on a
    busy machine.
    """
    ticking(2.0**-13)
    monkeypatch.setattr(distances._Excess, "chunk", 16)
    monkeypatch.setattr(check._Positives, "chunk", 2)
    monkeypatch.setattr(distances, "SAMPLES", 2000)


@pytest.fixture
def left(tmp_path):
    """A checkpoint of ``far()``."""
    wb.certify(far(), ball(), budget=0.0, checkpoint=tmp_path / "left")
    return tmp_path / "left"


def points() -> wb.Bounder:
    """A network."""
    return wb.fit(ball(), hidden=(6,), steps=20, device="cpu", progress=False)


@pytest.mark.parametrize("made", [far, points])
def test_stopped_again_and_again(tmp_path, made):
    bounder, file, shares = made(), tmp_path / "left.safetensors", []
    whole = wb.certify(bounder, ball())
    for calls in (1, 5, 10):
        told = []

        def progress(done, total, told=told, calls=calls):
            told.append(done / total)
            if len(told) == calls:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            wb.certify(bounder, ball(), progress=progress, checkpoint=file)
        assert file.exists()
        shares += told
    assert 0 < shares[-1] < 1
    proof = wb.certify(bounder, ball(), progress=lambda done, total: shares.append(done / total), checkpoint=file)
    assert (proof.kind, proof.boxes, proof.lower_bound) == ("proven", whole.boxes, whole.lower_bound)
    assert shares == sorted(shares)  # it goes on, it does not begin anew
    assert shares[-1] == 1
    assert not file.exists()
    late = wb.certify(bounder, ball(), budget=0.0, checkpoint=file)
    assert late.kind == "undecided"
    assert f"goes on from {file}" in late.message
    assert file.exists()


def test_a_checkpoint_is_of_one_claim(left):
    """Not of another margin, threshold, method's numbers or shape, nor of a function whose object is the same and whose
    distance is not."""
    content = left.read_bytes()
    dilated = far().to()
    dilated.info = far().info | {"margin": 0.01, "rates": None, "shape": None}
    tensors = far().tensors | {"values": far().tensors["values"] - np.float16(0.01)}
    lower = DistanceGrid(far().domain, tensors, far().sizes, "cpu").freeze(float(far().threshold), None)
    other = wb.shapes.Function(None, [-1, -1], [1, 1], distance=lambda x: np.abs(x).max(axis=1) - 1)
    for bounder, shape in (
        (dilated, ball()),
        (lower, ball()),
        (far(), ball(0.25)),
        (far(), other),
        (far().to().freeze(far().threshold - 1.0, None), ball()),
    ):
        bounder.info = far().info | bounder.info
        with pytest.raises(FileFormatError, match="another bounder, shape or version"):
            wb.certify(bounder, shape, checkpoint=left)
        assert left.read_bytes() == content


def spoilt(content: bytes):
    """Files that are no checkpoint, or a damaged one; of some the digest is made right again."""
    yield b"a file of mine"
    yield content[:-100]
    held = safetensors.numpy.load(content)
    length = int.from_bytes(content[:8], "little")
    entry = json.loads(json.loads(content[8 : 8 + length])["__metadata__"][KEY])
    first, document = sorted(k for k in held if k.startswith("lower"))[0], entry["left"]
    for changes, told, signed in (
        ({"found": held["found"] - 1}, {}, False),
        ({}, {"worths": document["worths"][:-1]}, False),
        ({"found": held["found"][:-1]}, {}, True),
        ({"found": held["found"].astype(np.float32)}, {}, True),
        ({first: held[first].T.copy()}, {}, True),
        ({first: held[first] + 9.0}, {}, True),
        ({first: held[first] * np.nan}, {}, True),
        ({first.replace("lower", "owner"): held[first.replace("lower", "owner")] + 10**6}, {}, True),
        ({first.replace("lower", "level"): held[first.replace("lower", "level")] - 10**6}, {}, True),
        ({}, {"worths": ["1"] * len(document["worths"])}, True),
        ({}, {"worths": [0.0] * (1 + len(document["worths"]))}, True),
        ({}, {"worths": None}, True),
        ({}, {"taken": -1}, True),
        ({}, {"boxes": 1.5}, True),
        ({}, {"seconds": float("inf")}, True),
    ):
        tensors, left = held | changes, document | told
        sha = digest_of(tensors, left) if signed else entry["sha256"]
        yield safetensors.numpy.save(tensors, metadata={KEY: json.dumps({"sha256": sha, "left": left})})
    yield safetensors.numpy.save(held, metadata={KEY: json.dumps({"sha256": digest_of(held, []), "left": []})})


def test_what_is_no_checkpoint_or_damaged_is_refused_and_kept(left, tmp_path):
    for content in spoilt(left.read_bytes()):
        left.write_bytes(content)
        with pytest.raises(FileFormatError) as error:
            wb.certify(far(), ball(), checkpoint=left)
        assert "\n" not in str(error.value)
        assert left.read_bytes() == content
    path = tmp_path / "far.safetensors"
    far().save(path)
    before = path.read_bytes()
    with pytest.raises(FileFormatError, match="expected the checkpoint of a proof"):
        wb.certify(far(), ball(), checkpoint=path)
    assert path.read_bytes() == before
    with pytest.raises(FileFormatError):
        wb.certify(far(), ball(), checkpoint=tmp_path)


def test_what_needs_none(tmp_path):
    with pytest.raises(BounderError, match="checkpoint"):
        wb.certify(wb.fit(ball(), "distance", "aabb", device="cpu"), ball(), checkpoint=tmp_path / "left")
    box = wb.fit(ball(), method="aabb", device="cpu")
    assert wb.certify(box, ball(), checkpoint=tmp_path / "left").proven
    assert not (tmp_path / "left").exists()
