"""A k-d tree of bits holds just the occupied cells, in fewer bits than they are, and files with other bits are refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

import warp_bounding as wb
from warp_bounding.bounders.kdtree.bits import Tree, blocks, build, nodes_of
from warp_bounding.errors import BounderError
from warp_bounding.queries import QUERIES, oracle, sample

occupancies = arrays(bool, array_shapes(min_dims=1, max_dims=4, min_side=1, max_side=9)).filter(
    lambda cells: cells.any()
)


def held(occupancy: np.ndarray, leaves: int | None = None) -> tuple[np.ndarray, Tree]:
    """Which cells lie in full leaves, and the tree."""
    (first, last), tree = build(occupancy, leaves)
    nodes, found = nodes_of(tree, last - first + 1), np.zeros(occupancy.shape, dtype=int)
    for low, high in zip(nodes.first[nodes.full] + first, nodes.last[nodes.full] + first, strict=True):
        found[tuple(slice(a, b + 1) for a, b in zip(low, high, strict=True))] += 1
    assert found.max() == 1  # no cell lies in two leaves
    return found.astype(bool), tree


@given(occupancies)
@settings(deadline=None, max_examples=60)
def test_full_leaves_are_the_occupied_cells(occupancy):
    found, _ = held(occupancy)
    assert (found == occupancy).all()


@given(occupancies, st.integers(1, 40))
@settings(deadline=None, max_examples=60)
def test_with_fewer_leaves_every_occupied_cell_is_held(occupancy, leaves):
    found, tree = held(occupancy, leaves)
    assert len(tree.full) <= leaves
    assert found[occupancy].all()


@given(occupancies)
@settings(deadline=None, max_examples=30)
def test_blocks_tell_how_many_nodes_are_halved_before(occupancy):
    inner = build(occupancy)[1].inner
    counts = blocks(inner).reshape(-1, 4)[:, 0]
    assert counts.tolist() == [int(inner[: 96 * index].sum()) for index in range(len(counts))]


@pytest.fixture(scope="module")
def ball() -> wb.IndicatorGrid:
    return wb.IndicatorGrid(np.linalg.norm(np.indices((40, 33, 25)) - [[[[19]]], [[[16]]], [[[12]]]], axis=0) < 11)


@pytest.mark.parametrize("query", [name for name, kind in QUERIES.items() if kind.is_region])
def test_what_it_does_not_deny_meets_the_cells_or_nearly_so(ball, query, rng):
    tree = wb.fit(ball, query=query, method="kd-tree", device="cpu", progress=False)
    x = sample(query, ball, 20_000, rng)
    truth = oracle(query, ball, "cpu", 1.0 if QUERIES[query].has_length else 0.0)(x)
    maybe = tree.query(x.astype(np.float32)).numpy() == 1
    assert tree.certificate.proven
    assert maybe[truth].all()
    assert (maybe & ~truth).mean() < 0.02  # cells are wider by what rounding and the proof need
    assert wb.certify(tree, ball).proven


def test_it_is_smaller_than_its_cells_and_the_more_so_the_finer_they_are():
    shares = []
    for cells in (32, 64):
        grid = wb.IndicatorGrid(np.linalg.norm(np.indices((cells,) * 3) - (cells - 1) / 2, axis=0) < 0.4 * cells)
        tree, voxels = (wb.fit(grid, method=m, device="cpu", progress=False) for m in ("kd-tree", "voxels"))
        shares.append(tree.nbytes / voxels.nbytes)
        assert wb.evaluate(tree, grid, 50_000).fp_rate < wb.evaluate(voxels, grid, 50_000).fp_rate + 0.1
    assert shares[0] < 0.6
    assert shares[1] < 0.6 * shares[0]


def test_fewer_leaves_are_fewer_bytes_and_looser(ball):
    fits = [wb.fit(ball, method="kd-tree", leaves=n, device="cpu", progress=False) for n in (40, 400, None)]
    assert fits[0].nbytes < fits[1].nbytes < fits[2].nbytes
    rates = [wb.evaluate(b, ball, 50_000) for b in fits]
    assert rates[0].fp_rate > rates[1].fp_rate > rates[2].fp_rate
    assert all(r.fn == 0 for r in rates)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda tree, extent: (tree._replace(inner=tree.inner[:-1]), extent),
        lambda tree, extent: (tree._replace(inner=np.append(tree.inner, [False, False])), extent),
        lambda tree, extent: (tree._replace(inner=~tree.inner), extent),
        lambda tree, extent: (tree._replace(inner=np.roll(tree.inner, 1)), extent),
        lambda tree, extent: (tree._replace(full=tree.full[:-1]), extent),
        lambda tree, extent: (tree, np.ones_like(extent)),
    ],
)
def test_bits_that_are_no_tree_are_refused(ball, spoil):
    (first, last), tree = build(ball.occupancy)
    nodes_of(tree, last - first + 1)
    with pytest.raises(BounderError, match="no tree"):
        nodes_of(*spoil(tree, last - first + 1))


@pytest.mark.parametrize(
    ("name", "value"), [("step", -1.0), ("step", 0.0), ("wide", -1.0), ("low", 1e30), ("step", 1e30)]
)
def test_numbers_that_make_no_sense_are_refused(ball, name, value):
    tree = wb.fit(ball, method="kd-tree", device="cpu", progress=False)
    tensors = dict(tree.tensors) | {name: np.full(3, value, np.float32)}
    with pytest.raises(BounderError, match="kd-tree"):
        type(tree)(tree.domain, tensors, tree.sizes, "cpu")


def test_a_cell_that_is_taken_away_is_found_by_the_proof(ball):
    tree = wb.fit(ball, method="kd-tree", device="cpu", progress=False)
    full = tree.tensors["full"].copy()
    leaf = int(np.flatnonzero(tree.tree.full)[0])
    full[leaf >> 5] &= ~np.uint32(1 << (leaf & 31))
    spoilt = type(tree)(tree.domain, dict(tree.tensors) | {"full": full}, tree.sizes, "cpu")
    assert not wb.certify(spoilt.freeze(tree.threshold, None), ball).proven
