"""A proof of a distance that is stopped goes on where it stopped, from a file that nothing else can pass for."""

import json
from copy import copy
from functools import cache

import numpy as np
import pytest
import safetensors.numpy
import trimesh
from shape_kinds import KINDS

import warp_bounding as wb
from warp_bounding import activations
from warp_bounding.bounders.distance_grid import DistanceGrid
from warp_bounding.bounders.file_format import digest_of
from warp_bounding.errors import BounderError, FileFormatError, ShapeError
from warp_bounding.networks import network_shape
from warp_bounding.proof import covering, distances
from warp_bounding.proof.halving import KEY, Checkpoint
from warp_bounding.shapes.recentred import Frame, Recentred


def ball(radius: float = 1.0) -> wb.shapes.Mesh:
    """A solid of twenty faces."""
    made = trimesh.creation.icosphere(0, radius)
    return wb.shapes.Mesh(made.vertices, made.faces)


def cells() -> wb.shapes.Grid:
    """The cells of a disc."""
    x = np.indices((10, 10)) - 4.5
    return wb.shapes.Grid((x**2).sum(axis=0) < 4.0**2)


def disc(x):
    return np.linalg.norm(x, axis=1) - 1.0


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
    monkeypatch.setattr(distances._Overestimates, "chunk", 16)
    monkeypatch.setattr(covering.ReachesTarget, "chunk", 2)
    monkeypatch.setattr(distances, "SAMPLES", 2000)


@pytest.fixture
def left(tmp_path):
    """A checkpoint of ``far()``."""
    wb.certify(far(), ball(), budget=0.0, checkpoint=tmp_path / "left")
    return tmp_path / "left"


def points() -> wb.Bounder:
    """A network."""
    return wb.fit(cells(), hidden=(6,), steps=20, device="cpu", progress=False)


@pytest.mark.parametrize(("made", "of"), [(far, ball), (points, cells)])
def test_stopped_again_and_again(tmp_path, made, of):
    bounder, shape, file, shares = made(), of(), tmp_path / "left.safetensors", []
    whole = wb.certify(bounder, shape)
    for calls in (1, 5, 10):
        told = []

        def progress(done, total, told=told, calls=calls):
            told.append(done / total)
            if len(told) == calls:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            wb.certify(bounder, shape, progress=progress, checkpoint=file)
        assert file.exists()
        shares += told
    assert 0 < shares[-1] < 1
    proof = wb.certify(bounder, shape, progress=lambda done, total: shares.append(done / total), checkpoint=file)
    assert (proof.kind, proof.boxes, proof.lower_bound) == ("proven", whole.boxes, whole.lower_bound)
    assert shares == sorted(shares)  # it goes on, it does not begin anew
    assert shares[-1] == 1
    assert not file.exists()
    late = wb.certify(bounder, shape, budget=0.0, checkpoint=file)
    assert late.kind == "undecided"
    assert f"goes on from {file}" in late.message
    assert file.exists()


def test_a_checkpoint_is_of_one_claim(left):
    """Not of another margin, threshold, method's numbers or shape."""
    content = left.read_bytes()
    dilated = far().to()
    dilated.info = far().info | {"margin": 0.01, "rates": None, "shape": None}
    tensors = far().tensors | {"values": far().tensors["values"] - np.float16(0.01)}
    lower = DistanceGrid(far().domain, tensors, far().sizes, "cpu").freeze(float(far().threshold), None)
    for bounder, shape in (
        (dilated, ball()),
        (lower, ball()),
        (far(), ball(0.9)),
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
        ({"maxima": held["maxima"] - 1}, {}, False),
        ({}, {"worths": document["worths"][:-1]}, False),
        ({"maxima": held["maxima"][:-1]}, {}, True),
        ({"maxima": held["maxima"].astype(np.float32)}, {}, True),
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


FUNCTIONS = {  # whatever a function of the user's decides
    "function": lambda: wb.shapes.Function(None, [-1, -1], [1, 1], distance=disc),
    "dilated": lambda: wb.shapes.Function(None, [-1, -1], [1, 1], distance=disc).dilated(0.25),
    "outside": lambda: wb.shapes.Complement(FUNCTIONS["function"]()),
    "far away": lambda: Recentred(FUNCTIONS["function"](), Frame((500000.0, 4e6), (0.0, 0.0))),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_have_none(name, tmp_path):
    """Their digests do not tell them apart, so it could go on for another one."""
    shape, path = FUNCTIONS[name](), tmp_path / "left"
    assert not shape.identified
    with pytest.raises(ShapeError, match=r"a checkpoint needs a shape that its digest identifies") as error:
        Checkpoint(path, points(), shape)
    assert "\n" not in str(error.value)
    if name == "far away":
        return
    bounder = wb.fit(shape, hidden=(6,), steps=20, statistical=True, device="cpu", progress=False)
    for prove in (wb.certify, wb.proof.make_proven):
        with pytest.raises(ShapeError, match="a checkpoint needs"):
            prove(bounder, shape, checkpoint=path)
    with pytest.raises(ShapeError, match="a checkpoint needs"):
        wb.choose(shape, narrow_ns=1.0, methods=("aabb",), checkpoint=path, progress=False)
    assert not path.exists()


@pytest.mark.parametrize("name", KINDS)
def test_only_functions_have_none(name):
    shape = KINDS[name]()
    assert shape.identified != isinstance(shape, wb.shapes.Function)


def test_a_network_of_modules_from_outside_is_not_identified(monkeypatch):
    """Its activation is code, as a function is."""
    monkeypatch.setitem(network_shape.MODULES, "Sine", copy(activations.SINE))
    assert not KINDS["network"]().identified
