"""Bounders of pieces of a shape, each in its own, smaller dimension, put together."""

from functools import cache

import numpy as np
import pytest
from asking import ask
from rewriting import rewrite

import warp_bounding as wb
from warp_bounding.bounders.composition.composition import Composition
from warp_bounding.errors import BounderError, FileFormatError, IndicatorError
from warp_bounding.indicators.parts.pieces import Pieces

STEPS, COUNT = 400, 60_000


@cache
def shape(self_collision: bool = True) -> wb.arms.ArmConfigurations:
    """A planar arm of three joints among posts, that may touch itself."""
    step = np.eye(4)
    step[0, 3] = 0.5
    joints = [wb.arms.Joint(step if i else np.eye(4), lower=-2.5, upper=2.5) for i in range(3)]
    links = [wb.arms.Body.capsule([0, 0, 0], [0.5, 0, 0], 0.1, link=i) for i in range(3)]
    posts = [wb.arms.Body.sphere(place, 0.2) for place in ([0.6, 0.7, 0], [-0.7, 0.6, 0], [0.4, -1.0, 0])]
    arm = wb.arms.Arm(joints, links)
    return wb.arms.ArmConfigurations(arm, posts, self_collision=self_collision, weights=arm.reaching)


@cache
def fitted(held: tuple[int, ...], method: str = "mlp") -> wb.Bounder:
    options = {"hidden": (8, 8), "steps": STEPS} if method == "mlp" else {}
    return wb.fit(shape().piece(held), method=method, device="cpu", progress=False, **options)


def asked(count: int = COUNT) -> np.ndarray:
    own = shape()
    return np.random.default_rng(1).uniform(own.lower - 0.1, own.upper + 0.1, (count, own.ndim)).astype(np.float32)


def maybe(bounder, x) -> np.ndarray:
    return bounder.query(x).numpy() == 1


def test_pieces_are_the_whole(rng):
    own = shape()
    x = rng.uniform(own.lower, own.upper, (20_000, 3))
    pieces = [own.piece([i]) for i in (1, 2)]
    assert [piece.ndim for piece in pieces] == [2, 3]
    found = [piece.contains(x[:, : piece.ndim]) for piece in pieces]
    assert (np.any(found, axis=0) == own.contains(x)).all()
    assert all((each & ~own.contains(x)).sum() == 0 and each.any() for each in found)
    both = own.piece([0, 1])
    assert (both.contains(x[:, :2]) == found[0]).all()  # link 0 meets nothing
    assert own.piece([0, 1, 2]) is own
    assert own.piece([2, 1]).piece([1]).digest == pieces[0].digest
    assert len({each.digest for each in (own, both, *pieces)}) == 4
    lower = x[:4000]
    upper = lower + rng.uniform(0, 0.3, lower.shape)
    free = np.all([piece.empty(lower[:, : piece.ndim], upper[:, : piece.ndim]) for piece in pieces], axis=0)
    assert (free == own.empty(lower, upper)).mean() > 0.99


def test_links_that_touch_each_other_belong_to_the_later_one():
    alone = wb.arms.ArmConfigurations(shape().arm)
    folded = np.array([[0.0, 2.5, 2.5]])
    assert alone.contains(folded)
    assert alone.piece([2]).contains(folded)
    with pytest.raises(IndicatorError, match="nothing that could touch"):
        alone.piece([1])


@pytest.mark.parametrize("held", [[], [3], [-1], [0.0], [True], ["0"]])
def test_numbers_of_no_pieces(held):
    with pytest.raises(IndicatorError, match="expected some of the pieces 0 to 2"):
        shape().piece(held)
    with pytest.raises(IndicatorError, match="it has no pieces"):
        wb.load_indicator(np.pad(np.ones((4, 4), bool), 2)).piece(held)
    with pytest.raises(IndicatorError, match="has no links"):
        shape().piece([1]).piece([2])


@pytest.mark.parametrize("methods", [("mlp", "mlp"), ("mlp", "learned-kdop"), ("aabb", "sphere")])
def test_bounders_of_pieces_together(methods, tmp_path):
    one, other, x = fitted((0, 1), methods[0]), fitted((2,), methods[1]), asked()
    assert (one.ndim, other.ndim) == (2, 3)
    for whole in (one | other, other | one)[: 2 if methods == ("mlp", "mlp") else 1]:
        assert isinstance(whole, Composition)
        assert whole.ndim == 3
        assert whole.certificate.proven
        assert whole.certificate.indicator == shape().digest
        assert whole.info["pieces"] is None
        found = maybe(whole, x)
        assert not (shape().contains(x) & ~found).any()
        within = (np.abs(whole.domain.to_local(x)) <= whole.domain.limit * (1 - 1e-6)).all(axis=1)
        want = maybe(one, x[:, :2].copy()) | maybe(other, x)
        assert (found[within] == want[within]).mean() > 0.9999
        assert (maybe(whole.to("cpu", native=False), x[:5000]) == found[:5000]).mean() > 0.999
        assert wb.certify(whole, shape(), seconds=120).proven
        whole.save(tmp_path / "whole.safetensors")
        again = wb.load(tmp_path / "whole.safetensors", device="cpu")
        assert (maybe(again, x) == found).all()
        assert again.certificate == whole.certificate
        assert wb.evaluate(again, shape(), samples=20_000).fn == 0
    box = wb.fit(shape(), method="aabb", device="cpu", progress=False)
    both = box & (one | other)
    assert wb.certify(both, shape(), seconds=120).proven


def test_asked_in_a_kernel():
    whole, x = fitted((0, 1)) | fitted((2,)), asked(5000)

    answers = ask(whole, x).astype(bool)
    assert (answers == maybe(whole, x)).mean() > 0.9999
    assert not (shape().contains(x) & ~answers).any()


def test_whole_segments(rng):
    whole, own = fitted((0, 1)) | fitted((2,)), shape()
    starts, ends = (rng.uniform(own.lower, own.upper, (4000, 3)).astype(np.float32) for _ in range(2))
    ends = starts + np.float32(0.05) * (ends - starts)
    clear = wb.clear_segments(whole, starts, ends)
    assert clear.mean() > 0.01
    for t in np.linspace(0, 1, 33):
        assert not own.contains((1 - t) * starts[clear].astype(np.float64) + t * ends[clear]).any()


def test_some_pieces_are_not_the_whole(tmp_path):
    part = fitted((2,))
    part.save(tmp_path / "part.safetensors")
    again = wb.load(tmp_path / "part.safetensors", device="cpu")
    assert again.info["pieces"] == {"whole": shape().digest, "count": 3, "held": [2]}
    assert wb.certify(again, shape().piece([2]), seconds=120).proven
    assert wb.certify(fitted((0, 1)), shape(), seconds=20).kind == "inapplicable"
    some = fitted((1,)) | fitted((2,))  # link 0 could touch nothing, but nobody has shown that
    assert Pieces.from_dict(some.info["pieces"]).held == (1, 2)
    assert some.certificate.indicator == shape().piece([1, 2]).digest
    found = wb.certify(some, shape(), seconds=20)
    assert found.kind == "undecided"
    assert "no part holds the pieces [0]" in found.message
    assert wb.certify(some, shape().piece([1, 2]), seconds=120).proven
    whole = some | fitted((0, 1))
    assert whole.info["pieces"] is None
    assert wb.certify(whole, shape(), seconds=120).proven


def test_what_does_not_go_together():
    other = wb.arms.ArmConfigurations(shape().arm, shape().obstacles[:2], weights=shape().weights)
    foreign = wb.fit(other.piece([0, 1]), method="aabb", device="cpu", progress=False)
    with pytest.raises(BounderError, match="pieces of the same shape"):
        foreign | fitted((2,))
    with pytest.raises(BounderError, match="same queries and domain"):
        fitted((0, 1)) & fitted((2,))
    with pytest.raises(BounderError, match="same object"):
        fitted((0, 1)) | wb.fit(shape(), method="aabb", device="cpu", progress=False)


def test_a_file_that_lies_about_pieces(tmp_path):
    """A part that is said to hold what it was not fitted to is found out, whatever the digests say."""
    whole, file = fitted((0, 1)) | fitted((2,)), tmp_path / "w.safetensors"
    whole.save(file)

    def lie(document):
        document["sizes"]["parts"][0]["held"], document["sizes"]["parts"][1]["held"] = [0], [1, 2]

    rewrite(file, lie)
    assert not wb.certify(wb.load(file, device="cpu"), shape(), seconds=20).proven

    def nothing(document):
        del document["sizes"]["parts"][0]["held"]

    rewrite(file, nothing)
    with pytest.raises(FileFormatError, match="that holds no pieces"):
        wb.load(file, device="cpu")

    def none(document):
        document["sizes"]["parts"][0]["held"] = ["x"]

    rewrite(file, none)
    with pytest.raises(FileFormatError, match="expected numbers of pieces"):
        wb.load(file, device="cpu")
