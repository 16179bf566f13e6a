"""Answers are bool, wherever they are asked for: as a mask they pick the queries that are *maybe*."""

import numpy as np
import pytest
import warp as wp
from asking import ask
from bounding_shapes import fitted, fitted_query, shape
from distances import far, points_around, thing
from plain_shapes import TETRAHEDRON

import warp_bounding as wb
from warp_bounding.bounders import DISTANCES, METHODS
from warp_bounding.errors import QueryError
from warp_bounding.queries import QUERIES, sample

NAME, COUNT = "blob", 1003  # no whole number of lanes
COMPILED = ("kdop", "bvh")  # of regions, also by other tests
CASES = [
    pytest.param(method, query, marks=() if query == "point" or method in COMPILED else pytest.mark.slow)
    for method, kind in METHODS.items()
    for query in QUERIES
    if kind.supports(query, 3)
]


def unset(count: int = COUNT) -> wp.array:
    """Memory for answers, in which no byte is that of a bool."""
    return wp.full(count, 7, dtype=wp.uint8, device="cpu").view(wp.bool)


def check(answers: wp.array, queries: np.ndarray) -> np.ndarray:
    """The mask of these answers, which picks as many queries as are *maybe*; their bytes are 0 and 1."""
    mask = answers.numpy()
    assert (answers.dtype, mask.dtype) == (wp.bool, bool)
    assert set(np.unique(mask.view(np.uint8))) <= {0, 1}
    assert len(queries[mask]) == np.count_nonzero(mask)
    return mask


@pytest.mark.parametrize(("method", "query"), CASES)
def test_of_queries(method, query, rng):
    bounder = fitted(method, NAME) if query == "point" else fitted_query(NAME, method, query, 1.0)
    x = sample(query, shape(NAME), COUNT, rng).astype(np.float32)
    x[::50] = np.nan
    mask = check(bounder.query(x, out=unset()), x)
    assert mask[::50].all()
    assert (check(bounder.query(x), x) == mask).all()
    prepared = bounder.prepare(x, out=unset(), candidates=True)
    indices, count = prepared.launch()
    assert (check(prepared.out, x) == mask).all()
    assert (indices.numpy()[: int(count.numpy()[0])] == np.flatnonzero(mask)).all()


@pytest.mark.parametrize(
    "method", [m if m in ("kdop", "mlp") else pytest.param(m, marks=pytest.mark.slow) for m in DISTANCES]
)
def test_of_distances(method, rng):
    bounder, x = far(method, NAME), points_around(thing(NAME), COUNT, rng)[:COUNT]
    x[::50] = np.nan
    ends = x + np.float32(0.1)
    assert 0 < check(bounder.query(x, 0.1, out=unset()), x).sum() < COUNT
    assert 0 < check(bounder.query(x, np.full(COUNT, 0.1)), x).sum() < COUNT
    check(bounder.segments(x, ends)[0], x)
    check(bounder.rays(np.hstack([x, ends - x]), length=1.0)[0], x)
    check(bounder.boxes(x, ends, out=unset()), x)
    indices, count = bounder.candidates(x, 0.1)
    assert len(indices.numpy()[: int(count.numpy()[0])]) == len(x[bounder.query(x, 0.1).numpy()])


def test_of_what_is_put_together(rng):
    x = sample("point", shape(NAME), COUNT, rng).astype(np.float32)
    x[::50] = np.nan
    first, other = (fitted(method, NAME) for method in ("kdop", "aabb"))
    both = check(wb.cascade(first, other).query(x, out=unset()), x)
    assert (both == first.query(x).numpy() & other.query(x).numpy()).all()


def test_of_pairs(rng):
    mesh = wb.shapes.Mesh(*TETRAHEDRON)
    pair = wb.pairs.Pair(wb.fit(mesh, "distance", "aabb", device="cpu"), wb.pairs.Balls.of(mesh, 64))
    here = np.array([[0, 0, 0, 0, 0, 0, 1]], np.float32)
    there = np.hstack([rng.uniform(-4, 4, (COUNT, 3)), np.tile([0, 0, 0, 1], (COUNT, 1))]).astype(np.float32)
    assert 0 < check(pair.query(here, there, out=unset()), there).sum() < COUNT
    still = np.zeros((1, 6), np.float32)
    assert 0 < check(pair.contact_time(here, there, still, still)[0], there).sum() < COUNT
    with pytest.raises(QueryError, match="dtype bool"):
        pair.query(here, there, out=wp.zeros(COUNT, dtype=wp.uint8, device="cpu"))


def test_of_shapes_and_segments(rng):
    bounder, x = fitted("aabb", NAME), sample("point", shape(NAME), COUNT, rng)
    for mask in (shape(NAME).contains(x), wb.proof.clear_segments(bounder, x, x + 0.1)):
        assert mask.dtype == bool
        assert len(x[mask]) == np.count_nonzero(mask)


def test_a_function_answers_bool_in_a_kernel():
    """It is written to a mask as it is, and makes a condition."""
    bounder = fitted("aabb", NAME)
    x = np.array([[1e6, 0, 0], [np.nan, 0, 0]], np.float32)
    assert x[ask(bounder, x)].shape == (1, 3)


def test_torch_sees_a_mask(rng):
    torch = pytest.importorskip("torch", reason="torch is not installed")
    x = torch.tensor(sample("point", shape(NAME), COUNT, rng).astype(np.float32))
    answers = fitted("aabb", NAME).query(x)
    mask = wp.to_torch(answers)
    assert mask.dtype == torch.bool
    assert len(x[mask]) == np.count_nonzero(answers.numpy())
    given = torch.zeros(COUNT, dtype=torch.bool)
    fitted("aabb", NAME).query(x, out=wp.from_torch(given))
    assert (given == mask).all()
    with pytest.raises(QueryError, match=r"out must be .*dtype bool, got one of .* uint8$"):
        fitted("aabb", NAME).query(x, out=wp.from_torch(given.byte()))
