"""Certainly not, maybe, certainly: bounders of a shape's complement, and both sides together."""

from functools import cache

import numpy as np
import pytest
import trimesh
import warp as wp

import warp_bounding as wb
from warp_bounding.bounders.two_sided import MAYBE, NO, YES
from warp_bounding.errors import BounderError, IndicatorError
from warp_bounding.indicators.parts import Complement
from warp_bounding.indicators.shape import IN, OUT
from warp_bounding.proof import soak

STEPS = 300


@cache
def shape(name: str):
    if name == "grid":
        return wb.load_indicator(np.linalg.norm(np.moveaxis(np.indices((20, 20)), 0, -1) - [9.5, 8.5], axis=-1) < 7)
    if name == "touching":  # the object reaches the border of its grid
        cells = np.zeros((12, 12), bool)
        cells[:, 3:9] = True
        return wb.load_indicator(cells)
    if name == "solid":
        return wb.solids.Sphere([0, 0], 0.7) - wb.solids.Sphere([0.5, 0], 0.3)
    return wb.load_indicator(trimesh.creation.icosphere(2, 0.5).apply_translation([3.0, 0.0, -1.0]))


SHAPES = ("grid", "touching", "solid", "mesh")


@cache
def inner(name: str, margin: float = 0.0) -> wb.Bounder:
    bounder = wb.fit(
        shape(name), side="inside", hidden=(12, 12), steps=STEPS, margin=margin, device="cpu", progress=False
    )
    assert bounder.certificate.proven
    return bounder


def around(name: str, count: int = 100_000) -> np.ndarray:
    of = shape(name)
    reach = 0.1 * of.extent.max()
    return np.random.default_rng(1).uniform(of.lower - reach, of.upper + reach, (count, of.ndim)).astype(np.float32)


@pytest.mark.parametrize("name", SHAPES)
def test_no_is_certainly_inside(name):
    bounder, x = inner(name).to("cpu"), around(name)
    denied = bounder.query(x).numpy() == 0
    assert denied.any()  # it is of use
    assert (shape(name).decide(x[denied]) != OUT).all()


@pytest.mark.parametrize("name", SHAPES)
def test_what_lies_outside_the_domain_is_maybe(name):
    bounder, n = inner(name).to("cpu"), shape(name).ndim
    far = np.concatenate([np.eye(n), -np.eye(n)]) * 1e3
    middle = (shape(name).lower + shape(name).upper) / 2
    beyond = np.concatenate([far, far + middle, np.full((1, n), np.nan), np.full((1, n), np.inf)])
    assert (bounder.query(beyond.astype(np.float32)).numpy() == 1).all()
    # just outside the box that holds the object, on each side
    for axis in range(n):
        for side, sign in ((shape(name).lower, -1), (shape(name).upper, 1)):
            x = np.tile(middle, (41, 1))
            x[:, axis] = side[axis] + sign * np.geomspace(1e-7, 1.0, 41)
            x = x.astype(np.float32)
            x = x[shape(name).decide(x) == OUT]
            assert (bounder.query(x).numpy() == 1).all()


@pytest.mark.parametrize("name", SHAPES)
def test_certify_soak_and_evaluate_know_the_side(name, tmp_path):
    inner(name).save(tmp_path / "b.safetensors")
    bounder = wb.load(tmp_path / "b.safetensors", device="cpu")
    assert bounder.domain.unbounded
    assert wb.certify(bounder, shape(name)).proven
    assert soak(bounder, shape(name), 100_000, seed=3).missed is None
    rates = wb.evaluate(bounder, shape(name), samples=50_000)
    assert rates.fn == 0
    assert rates.fp_rate < 100 - rates.positives  # some of the inside is certain
    raised = bounder.freeze(float(bounder.threshold) + 1e3, None)
    assert wb.certify(raised, shape(name)).kind == "refuted"


def test_the_other_side_is_not_what_is_proven():
    outer = wb.fit(shape("grid"), method="aabb", device="cpu", progress=False)
    lie = inner("grid").to("cpu")
    assert wb.certify(outer, Complement(shape("grid"))).kind == "inapplicable"
    assert wb.certify(lie, wb.load_indicator(~shape("grid").occupancy)).kind != "proven"


def test_a_margin_dilates_the_object():
    wide, x = inner("mesh", 0.2), around("mesh")
    denied = wide.query(x).numpy() == 0
    dilated = shape("mesh").dilated(0.2)
    assert (dilated.decide(x[denied]) != OUT).all()
    assert (shape("mesh").decide(x[denied]) == OUT).any()  # certainly within the margin, and not in the mesh
    assert wb.certify(wide, shape("mesh")).proven


@pytest.mark.parametrize("name", SHAPES)
def test_both_sides_classify(name):
    outer = wb.fit(shape(name), method="kdop", device="cpu", progress=False)
    both, x = wb.two_sided(outer, inner(name)), around(name)
    found, truth = both.classify(x).numpy(), shape(name).decide(x)
    assert (truth[found == NO] != IN).all()
    assert (truth[found == YES] != OUT).all()
    assert {NO, MAYBE, YES} == set(np.unique(found))
    torch = pytest.importorskip("torch")
    vectors = wp.array(x, dtype=wp.types.vector(x.shape[1], float), device="cpu")
    for same in (torch.from_numpy(x), vectors, x.astype(np.float64), x[:500].tolist()):
        np.testing.assert_array_equal(both.classify(same).numpy(), found[: len(same)])
    out = wp.full(len(x), 7, dtype=wp.uint8, device="cpu")
    assert both.classify(x, out=out) is out
    np.testing.assert_array_equal(out.numpy(), found)
    nothing = both.classify(np.zeros((0, shape(name).ndim), np.float32))
    assert nothing.shape == (0,)


def test_both_sides_in_a_kernel_and_placed():
    outer = wb.fit(shape("mesh"), method="sphere", device="cpu", progress=False)
    both, x = wb.two_sided(outer, inner("mesh")), around("mesh", 20_000)

    @wp.kernel(enable_backward=False)
    def ask(outside: wb.Data, inside: wb.Data, q: wp.array(dtype=wp.vec3), answers: wp.array(dtype=int)):
        i = wp.tid()
        answers[i] = wp.static(both.func)(outside, inside, q[i])

    q = wp.array(x, dtype=wp.vec3, device="cpu")
    answers = wp.zeros(len(x), dtype=int, device="cpu")
    wp.launch(ask, len(x), [both.outer.data, both.inner.data, q, answers], device="cpu")
    assert (answers.numpy() == both.classify(x).numpy()).all()
    moved = both.classify(x + np.float32(2), xform=wp.transform(wp.vec3(2.0), wp.quat_identity())).numpy()
    truth = shape("mesh").decide(x)
    assert (truth[moved == YES] != OUT).all()
    assert (moved == YES).any()


@cache
def moving() -> wb.IndicatorMotion:
    """A ball that moves along x and swells, in four seconds."""
    ball = trimesh.creation.icosphere(2, 0.5)
    frames = [ball.vertices * size + [shift, 0, 0] for size, shift in ((1.0, 0.0), (1.5, 0.4), (1.2, 1.0))]
    return wb.IndicatorMotion(np.array(frames), ball.faces, times=[0.0, 2.0, 4.0])


def test_the_complement_of_a_motion_has_its_times_and_no_others():
    outside, middle = Complement(moving()), np.array([0.2, 0.0, 0.0])
    times = np.array([-1e-6, 0.0, 1.0, 4.0, 4.0 + 1e-6])
    x = np.insert(np.tile(middle, (5, 1)), 0, times, axis=1)
    assert outside.decide(x).tolist() == [OUT, OUT, OUT, IN, OUT]
    far = x + np.array([0.0, 9.0, 9.0, 9.0])
    assert outside.decide(far).tolist() == [OUT, IN, IN, IN, OUT]

    reach = np.array([0.0, 0.05, 0.05, 0.05])
    lower, upper = np.array([x[1]] * 4) - reach, np.array([x[1]] * 4) + reach
    lower[:, 0], upper[:, 0] = [-0.1, -0.1, -0.2, 0.2], [0.1, 5.0, -0.1, 0.1]  # the last one is no box
    # over the beginning only the part after it counts; the ball leaves the second; before all times there is nothing
    assert outside.empty(lower, upper).tolist() == [True, False, True, False]
    assert outside.empty(lower, upper).tolist() == [True, False, True, False]  # its input is as it was
    away = np.array([0.0, 9.0, 9.0, 9.0])
    assert outside.inside(lower + away, upper + away).tolist()[:3] == [False, False, False]
    lower[:3, 0], upper[:3, 0] = 0.0, [0.1, 4.0, 4.1]
    assert outside.inside(lower + away, upper + away).tolist()[:3] == [True, True, False]


@pytest.mark.slow
def test_the_inside_of_a_motion_up_to_the_ends_of_its_times():
    bounder = wb.fit(moving(), side="inside", hidden=(16, 16), steps=1000, margin=0.1, device="cpu", progress=False)
    assert bounder.certificate.proven
    shape, rng = moving().dilated(0.1), np.random.default_rng(0)
    x = rng.uniform(shape.lower, shape.upper, (100_000, 4)).astype(np.float32)
    x[: len(x) // 2, 0] = rng.choice(
        [1e-3, 4.0 - 1e-3], len(x) // 2
    )  # close to the ends, where all of space is next to it
    denied, truth = bounder.query(x).numpy() == 0, shape.decide(x)
    assert (truth[denied] == IN).all()
    assert denied.sum() > (truth == IN).sum() / 5
    assert wb.certify(bounder, moving()).proven
    x[:, 0] = rng.choice([-1.0, -1e-6, 4.0 + 1e-5, 9.0], len(x))
    assert (bounder.query(x).numpy() == 1).all()


def test_a_cascade_of_inner_bounders_is_one():
    other = wb.fit(shape("grid"), side="inside", hidden=(8,), steps=30, device="cpu", progress=False)
    joined, x = wb.cascade(inner("grid"), other), around("grid")
    assert joined.certificate.proven
    assert joined.domain.unbounded
    assert wb.certify(joined, shape("grid")).proven
    denied = joined.query(x).numpy() == 0
    assert (shape("grid").decide(x[denied]) != OUT).all()
    with pytest.raises(BounderError):
        wb.cascade(inner("grid"), wb.fit(shape("grid"), method="aabb", device="cpu", progress=False))


def test_bad_input_has_one_clear_error():
    outer = wb.fit(shape("grid"), method="aabb", device="cpu", progress=False)
    with pytest.raises(BounderError, match="inner must be fitted with side='inside'"):
        wb.two_sided(outer, outer)
    with pytest.raises(BounderError, match="outer must be fitted with side='outside'"):
        wb.two_sided(inner("grid"), inner("grid"))
    with pytest.raises(BounderError, match="same object"):
        wb.two_sided(wb.fit(shape("touching"), method="aabb", device="cpu", progress=False), inner("grid"))
    with pytest.raises(BounderError, match="dimension"):
        wb.two_sided(wb.fit(shape("mesh"), method="aabb", device="cpu", progress=False), inner("grid"))
    with pytest.raises(BounderError, match="must be a bounder of points"):
        wb.two_sided(wb.fit(shape("grid"), "box", "aabb", device="cpu", progress=False), inner("grid"))
    with pytest.raises(BounderError, match="side must be one of outside, inside"):
        wb.fit(shape("grid"), side="both")
    with pytest.raises(BounderError, match="for point queries"):
        wb.fit(shape("grid"), "ray", side="inside")
    with pytest.raises(IndicatorError, match="no cells are laid"):
        wb.fit(shape("mesh"), method="bvh", side="inside")
    told = wb.IndicatorFunction(
        lambda x: (np.abs(x) <= 1).all(axis=1), [-1, -1], [1, 1], empty=lambda a, b: (a > 1).any(1) | (b < -1).any(1)
    )
    with pytest.raises(IndicatorError, match="no box to lie inside"):
        wb.fit(told, side="inside")
    with pytest.raises(BounderError, match="segments"):
        wb.clear_segments(inner("grid"), np.zeros((1, 2)), np.ones((1, 2)))
