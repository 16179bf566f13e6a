"""A proof of a distance that is stopped goes on where it stopped, from a file that nothing else can pass for."""

import json

import numpy as np
import pytest
import safetensors.numpy
from distances import far, thing

import warp_bounding as wb
from warp_bounding.bounders.distance_grid import DistanceGrid
from warp_bounding.errors import BounderError, FileFormatError
from warp_bounding.proof.distances import excesses as search


@pytest.fixture
def small_steps(monkeypatch):
    """Few boxes at a time, so that a small proof can be stopped in its midst."""
    monkeypatch.setattr(search, "CHUNK", 64)


def stopped_after(calls: int):
    """A progress callback that stops the proof after some calls, as Ctrl-C would."""
    shares = []

    def progress(done, total):
        shares.append(done / total)
        if len(shares) == calls:
            raise KeyboardInterrupt

    return progress, shares


@pytest.mark.usefixtures("small_steps")
@pytest.mark.parametrize("method", ["distance-grid", "mlp"])
def test_stopped_again_and_again(method, tmp_path):
    bounder, shape, file = far(method, "tetrahedron"), thing("tetrahedron"), tmp_path / "left.safetensors"
    whole, shares = wb.certify(bounder, shape), []
    for calls in (1, 20, 30):
        progress, told = stopped_after(calls)
        with pytest.raises(KeyboardInterrupt):
            wb.certify(bounder, shape, progress=progress, checkpoint=file)
        assert file.exists()
        shares += told
    assert shares == sorted(shares)  # it goes on, it does not begin anew
    assert 0 < shares[-1] < 1
    proof = wb.certify(bounder, shape, progress=lambda done, total: shares.append(done / total), checkpoint=file)
    assert (proof.kind, proof.boxes, proof.lower_bound) == ("proven", whole.boxes, whole.lower_bound)
    assert shares == sorted(shares)
    assert shares[-1] == 1
    assert not file.exists()


@pytest.mark.usefixtures("small_steps")
def test_time_that_is_over_loses_nothing(tmp_path):
    bounder, shape, file = far("distance-grid", "tetrahedron"), thing("tetrahedron"), tmp_path / "left"
    first = wb.certify(bounder, shape, seconds=0.0, checkpoint=file)
    assert first.kind == "undecided"
    assert f"goes on from {file}" in first.message
    assert wb.certify(bounder, shape, checkpoint=file).proven
    assert not file.exists()


@pytest.mark.usefixtures("small_steps")
def test_what_is_no_checkpoint_is_kept(tmp_path):
    bounder, shape, file = far("distance-grid", "tetrahedron"), thing("tetrahedron"), tmp_path / "left.safetensors"
    wb.certify(bounder, shape, seconds=0.0, checkpoint=file)
    content = file.read_bytes()
    tensors = bounder.tensors | {"values": bounder.tensors["values"] - np.float16(0.01)}
    lower = DistanceGrid(bounder.domain, tensors, bounder.sizes, "cpu").freeze(float(bounder.threshold), None)
    lower.info = bounder.info
    assert wb.certify(lower, shape).proven
    with pytest.raises(FileFormatError, match="another bounder, shape or version"):
        wb.certify(lower, shape, checkpoint=file)
    held = safetensors.numpy.load(content)
    with safetensors.safe_open(str(file), framework="numpy") as opened:
        metadata = opened.metadata()
    left = json.loads(metadata["warp_bounding_checkpoint"])
    assert left["left"]["levels"]
    for spoilt in (held | {"found": held["found"] - 1}, held):
        changed = (
            left if spoilt is not held else left | {"left": left["left"] | {"levels": left["left"]["levels"][:-1]}}
        )
        text = {"warp_bounding_checkpoint": json.dumps(changed)}
        file.write_bytes(safetensors.numpy.save(spoilt, metadata=text))
        with pytest.raises(FileFormatError, match="damaged"):
            wb.certify(bounder, shape, checkpoint=file)
    for foreign in (b"a file of mine", content[:-100]):
        file.write_bytes(foreign)
        with pytest.raises(FileFormatError):
            wb.certify(bounder, shape, checkpoint=file)
        assert file.read_bytes() == foreign
    bounder.save(tmp_path / "far.safetensors")
    before = (tmp_path / "far.safetensors").read_bytes()
    with pytest.raises(FileFormatError, match="expected the checkpoint of a proof"):
        wb.certify(bounder, shape, checkpoint=tmp_path / "far.safetensors")
    assert (tmp_path / "far.safetensors").read_bytes() == before
    with pytest.raises(FileFormatError):
        wb.certify(bounder, shape, checkpoint=tmp_path)


def test_what_needs_none(tmp_path):
    shape = thing("c")
    for bounder in (far("aabb", "c"), wb.fit(shape, method="kdop")):
        with pytest.raises(BounderError, match="checkpoint"):
            wb.certify(bounder, shape, checkpoint=tmp_path / "left")
