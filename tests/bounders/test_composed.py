"""Bounders made of others: they answer as their parts do, are proven part by part, and a wrong part is refuted."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import trimesh
import warp as wp
from asking import ask
from bounding_shapes import domain_points, fitted, object_points, reloaded, shape
from plain_shapes import ball_at
from region_cases import hard_regions
from rewriting import changed

import warp_bounding as wb
from warp_bounding.bounders import Cascade
from warp_bounding.bounders.cascade import MAYBE, NO, YES
from warp_bounding.errors import BounderError, QueryError
from warp_bounding.kernels.source import DENIED
from warp_bounding.proof import stress_test
from warp_bounding.shapes.complement import Complement
from warp_bounding.shapes.shape import IN, OUT

CHAINS = [("aabb", "kdop", "mlp"), ("sphere", "aabb", "mlp"), ("voxels", "mlp")]


def raised(bounder: wb.Bounder, x: np.ndarray, share: float) -> wb.Bounder:
    """A bounder that denies a share of some points, so that every part has something to do."""
    values = bounder.values(x).numpy()
    return bounder.to("cpu").freeze(float(np.quantile(values[np.isfinite(values)], share)), None)


def near(parts: list, x: np.ndarray) -> np.ndarray:
    """Which points lie so close to a threshold of a part that kernels may differ."""
    close = [np.abs(p.values(x).numpy() - float(p.threshold)) <= 2 * p.rounding_bound() for p in parts]
    assert np.any(close, axis=0).mean() < 0.2
    return np.any(close, axis=0)


def lost_bits(bounder: wb.Bounder, rng: np.random.Generator) -> wb.Bounder:
    """A bit field of which some words are lost, so that it denies some of the object."""
    bits = bounder.tensors["bits"] * (rng.integers(3, size=len(bounder.tensors["bits"])) > 0).astype(np.uint32)
    return changed(bounder, {"bits": bits})


@pytest.mark.parametrize("methods", CHAINS, ids="+".join)
def test_all_parts_must_pass(methods, device, rng):
    x = domain_points(shape("blob"), 5000, rng)
    parts = [m if m == "voxels" else 0.3 + 0.1 * i for i, m in enumerate(methods)]
    parts = [
        fitted(m, "blob") if s == m else raised(fitted(m, "blob"), x, s) for m, s in zip(methods, parts, strict=True)
    ]
    whole = wb.cascade(*parts).to(device)
    x = x[~near(parts, x)]
    answers = np.stack([part.to(device).query(x).numpy() for part in parts])
    assert (whole.query(x).numpy() == answers.all(axis=0)).all()
    assert (ask(whole, x) == answers.all(axis=0)).all()
    values, last = whole.values(x).numpy(), parts[-1].to(device).values(x).numpy()
    assert (values[answers[:-1].all(axis=0)] == last[answers[:-1].all(axis=0)]).all()
    assert (values[~answers[:-1].all(axis=0)] <= DENIED).all()


@pytest.mark.parametrize("methods", CHAINS, ids="+".join)
def test_what_is_proven_of_the_parts_is_proven_of_all(methods, tmp_path, rng):
    grid, whole = shape("blob"), wb.cascade(*(fitted(m, "blob") for m in methods))
    assert whole.certificate.proven
    inside = object_points(grid, rng)
    assert whole.query(inside).numpy().all()
    assert ask(whole, inside).all()
    again = reloaded(whole, tmp_path)
    x = domain_points(grid, 3000, rng)
    assert (again.query(x).numpy() == whole.query(x).numpy()).all()
    assert wb.certify(again, grid).proven
    assert wb.evaluate(again, grid, samples=20_000).fn == 0


def test_a_wrong_part_is_refuted(rng):
    grid, right = shape("blob"), fitted("mlp", "blob")
    wrong = raised(fitted("aabb", "blob"), object_points(grid, rng), 0.2)
    for whole in (wb.cascade(wrong, right), wb.cascade(right, wrong)):
        assert whole.certificate is None
        certificate = wb.certify(whole, grid)
        assert certificate.kind == "refuted"
        assert grid.contains(np.float64([certificate.counterexample])).all()


@pytest.mark.parametrize("query", ["ray", "plane", "box"])
def test_regions(query, rng):
    grid = shape("c")
    parts = [wb.fit(grid, query, m, device="cpu") for m in ("aabb", "bvh")]
    whole, x = wb.cascade(*parts), hard_regions(query, grid, rng, 1.0, 3000)
    answers = np.stack([part.query(x).numpy() for part in parts])
    assert (whole.query(x).numpy() == answers.all(axis=0)).all()
    assert whole.certificate.kind == parts[-1].certificate.kind
    if whole.certificate.proven:
        assert wb.certify(whole, grid).proven


def test_bounds_are_those_of_the_whole(rng):
    whole = Cascade.of([fitted("aabb", "blob"), fitted("mlp", "blob")])
    low = rng.uniform(-1, 1, (500, 3))
    high = low + 10 ** rng.uniform(-4, 0, (500, 1))
    bounds = whole.bound(low, high)
    for t in rng.random((20, 1, 3)):
        assert (whole.reference(low + t * (high - low)) >= bounds.lower).all()


def test_several_parts_may_have_bit_fields(tmp_path, device, rng):
    """In any order, and in a cascade within a cascade, every part reads its own words."""
    grid, x, first = shape("blob"), domain_points(shape("blob"), 5000, rng), fitted("voxels", "blob")
    parts = [lost_bits(first, rng), fitted("aabb", "blob"), first]
    whole = wb.cascade(parts[0], wb.cascade(*parts[1:]))
    expected = np.all([part.query(x).numpy() for part in parts], axis=0)
    assert 0 < expected.sum() < len(x)
    for each in (whole, reloaded(whole, tmp_path).to(device)):
        assert (each.query(x).numpy() == expected).all()
        assert (ask(each, x) == expected).all()
    assert wb.certify(whole, grid).kind == "refuted"
    assert wb.certify(wb.cascade(first, first), grid).proven


def fit(of, *query, method="aabb", **told) -> wb.Bounder:
    return wb.fit(of, *query, method=method, device="cpu", progress=False, **told)


def test_what_cannot_be_put_together():
    aabb, kdop, mlp, occupancy = (fitted(method, "blob") for method in ("aabb", "kdop", "mlp", "occupancy"))
    whole, other, foreign = wb.cascade(aabb, kdop), aabb.to("cpu"), aabb.to("cpu")
    other.info = aabb.info | {"indicator": "another"}
    foreign.freeze(float(aabb.threshold), replace(aabb.certificate, indicator="0" * 64))
    for parts, message in (
        ((aabb,), "2 to 8"),
        ((aabb, fitted("mlp", "c")), "same queries and domain"),  # of another dimension
        ((aabb, occupancy), "not conservative"),
        ((other, mlp), "same object"),
        ((foreign, mlp), "certificates of the same object"),
        ((whole, aabb), "only the last part may have"),
        ((aabb, fit(shape("blob"), "box")), "same queries and domain"),
        ([fit(shape("blob"), "ray", length=length) for length in (2.0, 0.5)], "same queries and domain"),
        ((aabb, fit(shape("blob"), margin=0.05)), "of the same"),
        ((aabb, fit(shape("blob"), "distance")), "cascade: "),
    ):
        with pytest.raises(BounderError, match=message):
            wb.cascade(*parts)
    nested = {"parts": [{"method": "cascade", "sizes": whole.sizes}, *whole.sizes["parts"][1:]]}
    chain = wb.cascade(aabb, mlp)
    for kind, tensors, sizes in (
        (Cascade, whole.tensors, nested),
        (Cascade, chain.tensors | {"9.low": np.zeros(3, np.float32)}, chain.sizes),
        (Cascade, chain.tensors, {"parts": []}),
    ):
        with pytest.raises(BounderError):
            kind(whole.domain, dict(tensors), sizes, "cpu")


SIDED = ("touching", "mesh")


@cache
def sided(name: str):
    if name == "touching":  # the object reaches the border of its grid
        cells = np.zeros((12, 12), bool)
        cells[:, 3:9] = True
        return wb.load_shape(cells)
    return wb.load_shape(trimesh.creation.icosphere(2, 0.5).apply_translation([3.0, 0.0, -1.0]))


@cache
def inner(name: str, margin: float = 0.0) -> wb.Bounder:
    hidden = (12, 12) if margin else (8,)
    bounder = fit(sided(name), method="mlp", side="inside", hidden=hidden, steps=300, margin=margin)
    assert bounder.certificate.proven
    return bounder


def around_it(name: str, count: int = 30_000) -> np.ndarray:
    of = sided(name)
    reach = 0.1 * of.extent.max()
    return np.random.default_rng(1).uniform(of.lower - reach, of.upper + reach, (count, of.ndim)).astype(np.float32)


@pytest.mark.parametrize("name", SIDED)
def test_what_lies_outside_the_domain_is_maybe(name):
    bounder, n = inner(name).to("cpu"), sided(name).ndim
    far = np.concatenate([np.eye(n), -np.eye(n)]) * 1e3
    middle = (sided(name).lower + sided(name).upper) / 2
    beyond = np.concatenate([far, far + middle, np.full((1, n), np.nan), np.full((1, n), np.inf)])
    assert (bounder.query(beyond.astype(np.float32)).numpy() == 1).all()
    # just outside the box that holds the object, on each side
    for axis in range(n):
        for side, sign in ((sided(name).lower, -1), (sided(name).upper, 1)):
            x = np.tile(middle, (41, 1))
            x[:, axis] = side[axis] + sign * np.geomspace(1e-7, 1.0, 41)
            x = x.astype(np.float32)
            x = x[sided(name).decide(x) == OUT]
            assert (bounder.query(x).numpy() == 1).all()


@pytest.mark.parametrize(("name", "margin"), [*((name, 0.0) for name in SIDED), ("mesh", 0.2)])
def test_no_is_certainly_inside(name, margin, tmp_path):
    """Within the margin, if there is one."""
    bounder, of, dilated = reloaded(inner(name, margin), tmp_path), sided(name), sided(name).dilated(margin)
    assert bounder.domain.unbounded
    x = around_it(name)
    denied = bounder.query(x).numpy() == 0
    assert denied.any()  # it is of use
    assert (dilated.decide(x[denied]) != OUT).all()
    assert margin == 0 or (of.decide(x[denied]) == OUT).any()  # certainly within the margin, and not in the mesh
    assert wb.certify(bounder, of).proven
    assert stress_test(bounder, of, 20_000, seed=3).missed is None
    rates = wb.evaluate(bounder, of, samples=50_000)
    assert rates.fn == 0
    assert rates.fp_rate < 100 - rates.positives  # some of the inside is certain
    raised = bounder.freeze(float(bounder.threshold) + 1e3, None)
    assert wb.certify(raised, of).kind == "refuted"


def test_both_sides_classify_in_a_kernel_and_placed():
    both, x = wb.two_sided(fit(sided("mesh"), method="sphere"), inner("mesh")), around_it("mesh", 20_000)
    found, truth = both.classify(x).numpy(), sided("mesh").decide(x)
    assert (truth[found == NO] != IN).all()
    assert (truth[found == YES] != OUT).all()
    assert {NO, MAYBE, YES} == set(np.unique(found))
    assert both.classify(np.zeros((0, 3), np.float32)).shape == (0,)
    out = wp.full(len(x), 7, dtype=wp.uint8, device="cpu")
    assert both.classify(x, out=out) is out
    assert (out.numpy() == found).all()
    with pytest.raises(QueryError, match=r"out must be .* of shape \(20000,\) and dtype uint8, got one of .* bool$"):
        both.classify(x, out=out.view(wp.bool))

    @wp.kernel(enable_backward=False)
    def ask(outside: wb.Data, inside: wb.Data, q: wp.array(dtype=wp.vec3), answers: wp.array(dtype=int)):
        i = wp.tid()
        answers[i] = wp.static(both.func)(outside, inside, q[i])

    q = wp.array(x, dtype=wp.vec3, device="cpu")
    answers = wp.zeros(len(x), dtype=int, device="cpu")
    wp.launch(ask, len(x), [both.outer.data, both.inner.data, q, answers], device="cpu")
    assert (answers.numpy() == found).all()
    moved = both.classify(x + np.float32(2), xform=wp.transform(wp.vec3(2.0), wp.quat_identity())).numpy()
    assert (truth[moved == YES] != OUT).all()
    assert (moved == YES).any()


@cache
def moving() -> wb.shapes.MovingMesh:
    """A ball that moves along x and swells, in four seconds."""
    ball = trimesh.creation.icosphere(2, 0.5)
    frames = [ball.vertices * size + [shift, 0, 0] for size, shift in ((1.0, 0.0), (1.5, 0.4), (1.2, 1.0))]
    return wb.shapes.MovingMesh(np.array(frames), ball.faces, times=[0.0, 2.0, 4.0])


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


def test_a_cascade_of_inner_bounders_is_one():
    other = fit(sided("touching"), method="mlp", side="inside", hidden=(8,), steps=30)
    joined, x = wb.cascade(inner("touching"), other), around_it("touching")
    assert joined.certificate.proven
    assert joined.domain.unbounded
    assert wb.certify(joined, sided("touching")).proven
    denied = joined.query(x).numpy() == 0
    assert (sided("touching").decide(x[denied]) != OUT).all()
    with pytest.raises(BounderError):
        wb.cascade(inner("touching"), fit(sided("touching")))


def test_bad_input_has_one_clear_error():
    outer, solid = fit(sided("touching")), ball_at([0, 0], 0.7)
    for one, other, message in (
        (outer, outer, "inner must be fitted with side='inside'"),
        (inner("touching"), inner("touching"), "outer must be fitted with side='outside'"),
        (fit(solid), inner("touching"), "same object"),
        (fit(sided("mesh")), inner("touching"), "dimension"),
        (fit(sided("touching"), "box"), inner("touching"), "must be a bounder of points"),
    ):
        with pytest.raises(BounderError, match=message):
            wb.two_sided(one, other)
    told = wb.shapes.Function(
        lambda x: (np.abs(x) <= 1).all(axis=1), [-1, -1], [1, 1], empty=lambda a, b: (a > 1).any(1) | (b < -1).any(1)
    )
    for of, query, method, side, message in (
        (sided("touching"), "point", "mlp", "both", "side must be one of outside, inside"),
        (sided("touching"), "plane", "kdop", "inside", "for point queries"),
        (sided("mesh"), "point", "bvh", "inside", "no cells are laid"),
        (told, "point", "mlp", "inside", "no box to lie inside"),
    ):
        with pytest.raises(wb.BoundingError, match=message):
            wb.fit(of, query, method, side=side)
    with pytest.raises(BounderError, match="segments"):
        wb.proof.clear_segments(inner("touching"), np.zeros((1, 2)), np.ones((1, 2)))
