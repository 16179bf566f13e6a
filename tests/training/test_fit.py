"""``fit``: the loop runs, is repeatable, keeps its budget and survives Ctrl-C; cascades share their time."""

import pytest
from bounding_shapes import HIDDEN, few, object_points, report_of, shape

import warp_bounding as wb
from warp_bounding.bounders.bvh import Bvh, build
from warp_bounding.errors import BounderError
from warp_bounding.proof import prove
from warp_bounding.queries.domain import Domain
from warp_bounding.training import fit_network as networks


@pytest.fixture(autouse=True)
def _short_proofs(monkeypatch):
    """Three layers of sines that are hardly trained can keep a proof busy for long; it holds wherever it ends."""
    monkeypatch.setattr(networks, "MINE_POINTS_BOXES", 100_000)
    monkeypatch.setattr(networks, "PROOF_BOXES", 100_000)


def same(a, b) -> bool:
    return all(a.tensors[k].tobytes() == b.tensors[k].tobytes() for k in a.tensors) and a.threshold == b.threshold


def test_steps_are_repeatable_and_seeds_differ():
    first = few(steps=8, seed=4)
    assert same(first, few(steps=8, seed=4))
    assert not same(first, few(steps=8, seed=5))


def test_the_budget_is_kept(ticking):
    clock = ticking(0.02)
    bounder = few("star", steps=None, budget=3.0)
    assert clock.seconds < 3.0 * 1.1 + 0.5  # a proof may be late by a tenth, and something comes before and after
    assert bounder.certificate.proven
    assert bounder.info["training"]["steps"] > 10


def test_an_interrupt_keeps_the_best_so_far():
    calls = []

    def interrupt(done, total, note):
        calls.append((done, total, note))
        if len(calls) == 2:
            raise KeyboardInterrupt

    bounder = few(steps=10_000, progress=interrupt)
    assert bounder.certificate.proven
    assert bounder.info["training"]["interrupted"]
    assert bounder.info["training"]["steps"] < 10_000
    assert wb.certify(bounder, shape("blob")).proven
    assert not same(bounder, few(steps=1))  # not the weights that it began with


def test_an_interrupt_before_the_first_step():
    def interrupt(*_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):  # the second one, while the proof runs, is heard
        few(progress=interrupt)


def test_a_hierarchy_whose_time_is_over_has_fewer_boxes_and_is_proven(rng):
    grid = shape("blob")
    whole = build(grid, 16)
    hurried = build(grid, 16, seconds=0.0)
    assert len(hurried.first) == 1 < len(whole.first)
    bounder = Bvh.fit(grid, Domain.of(grid), leaves=16, seconds=0.0, device="cpu")
    prove(bounder, grid)
    assert bounder.certificate.proven
    assert bounder.query(object_points(grid, rng, 1000)).numpy().all()


def parts_of(name, method, query="point", **options):
    known = all(part in wb.METHODS for part in method.split("+"))
    small = report_of(method, query, hidden=HIDDEN, steps=20) if known else {}
    return wb.fit(shape(name), query, method, **({"device": "cpu"} | small | options))


@pytest.mark.parametrize("query", ["point", "ray", "plane", "box"])
@pytest.mark.parametrize("method", ["learned-kdop+mlp", pytest.param("kdop+mlp-early", marks=pytest.mark.slow)])
def test_a_cascade_is_fitted_and_says_what_its_parts_say(query, method, tmp_path):
    bounder, grid = parts_of("blob", method, query=query), shape("blob")
    assert bounder.method == "cascade"
    assert [entry["method"] for entry in bounder.sizes["parts"]] == method.split("+")
    assert bounder.certificate.kind in ("proven", "statistical")
    assert bounder.info["indicator"] == grid.digest
    assert len(bounder.info["training"]["parts"]) == 2
    assert bounder.info["training"]["seconds"] >= sum(p["seconds"] for p in bounder.info["training"]["parts"]) - 0.01
    assert wb.evaluate(bounder, grid, samples=50_000).fn == 0
    bounder.save(tmp_path / "a.safetensors")
    assert wb.load(tmp_path / "a.safetensors").certificate == bounder.certificate


@pytest.mark.parametrize(
    ("method", "message"),
    [
        ("aabb+occupancy", "occupancy is not conservative"),
        ("mlp-early+mlp", "only the last part may have exits"),
        ("aabb+", "method must be one of"),
        ("aabb+magic", "method must be one of"),
        ("+".join(["aabb"] * 9), "2 to 8"),
    ],
)
def test_what_is_no_cascade_is_refused_before_anything_is_fitted(method, message, monkeypatch):
    monkeypatch.setattr(networks, "_Fit", None)
    with pytest.raises(BounderError, match=message):
        parts_of("c", method)


def test_a_last_part_that_is_fitted_already_is_taken_as_it_is_where_it_belongs(monkeypatch):
    network, grid = parts_of("star", "mlp", query="ray"), shape("star")
    monkeypatch.setattr(networks, "_Fit", None)
    whole = parts_of("star", "learned-kdop+mlp", query="ray", last=network)
    assert whole.threshold == network.threshold
    assert len(whole.tensors["0.offsets"]) == 40
    assert whole.certificate.kind == network.certificate.kind
    assert whole.info["training"]["seconds"] > network.info["training"]["seconds"]
    assert wb.evaluate(whole, grid).fp_rate < wb.evaluate(network, grid).fp_rate
    for name, method, query, words in (
        ("star", "mlp+kdop", "ray", "last must be the last of several methods"),
        ("c", "learned-kdop+mlp", "ray", "same"),
        ("star", "kdop+mlp", "box", "same queries and domain"),
    ):
        with pytest.raises(BounderError, match=words):
            parts_of(name, method, query=query, last=network)
