"""``fit`` of several methods at once: a cascade, its time shared, its network's threshold judged behind the parts before it."""

import numpy as np
import pytest
from bounding_shapes import shape, told_of

import warp_bounding as wb
from warp_bounding.errors import BounderError, QueryError
from warp_bounding.queries import sample
from warp_bounding.training import fit_network as networks
from warp_bounding.training.fit_network import Costs
from warp_bounding.training.samples import Problem


def few(name, method, query="point", **options):
    known = all(part in wb.METHODS for part in method.split("+"))
    small = told_of(method, query, hidden=(12, 12), steps=60) if known else {}
    return wb.fit(shape(name), query, method, **({"device": "cpu"} | small | options))


@pytest.mark.parametrize("query", ["point", "ray", "plane", "box"])
@pytest.mark.parametrize(
    "method", ["learned-kdop+mlp", *(pytest.param(m, marks=pytest.mark.slow) for m in ("aabb+mlp", "kdop+mlp-early"))]
)
def test_a_cascade_is_fitted_and_says_what_its_parts_say(query, method, tmp_path):
    bounder, grid = few("blob", method, query=query), shape("blob")
    assert bounder.method == "cascade"
    parts = [entry["method"] for entry in bounder.sizes["parts"]]
    assert parts == method.split("+")
    assert bounder.certificate.kind in ("proven", "statistical")
    assert bounder.info["indicator"] == grid.digest
    assert len(bounder.info["training"]["parts"]) == 2
    assert bounder.info["training"]["seconds"] >= sum(p["seconds"] for p in bounder.info["training"]["parts"]) - 0.01
    assert wb.evaluate(bounder, grid, samples=50_000).fn == 0
    bounder.save(tmp_path / "a.safetensors")
    assert wb.load(tmp_path / "a.safetensors").certificate == bounder.certificate


def test_boxes_behind_a_monotone_network():
    bounder = few("blob", "learned-kdop+monotone-mlp", query="box")
    assert bounder.certificate.proven
    assert wb.certify(bounder, shape("blob")).proven


@pytest.mark.parametrize("query", ["point", "ray", "box"])
def test_what_a_threshold_costs_is_counted_behind_the_front(query):
    grid = shape("star")
    front = few("star", "kdop", query=query)
    network = few("star", "mlp", query=query, steps=3)
    problems = [Problem(grid, network.domain, query, 0, "cpu", parts) for parts in ((), (front,))]
    whole, behind = (Costs(network, problem) for problem in problems)
    assert 0 < len(behind.values) < len(whole.values)
    assert np.isin(behind.values, whole.values).all()
    x = sample(query, grid, 1000, np.random.default_rng(0))
    assert problems[0].asked(x).all()
    assert (problems[1].asked(x) == front.query(x).numpy()).all()


def test_a_network_behind_others_is_the_one_that_it_is_by_itself():
    alone, behind = few("star", "mlp"), few("star", "learned-kdop+mlp")
    assert all((behind.tensors[f"1.{name}"] == t).all() for name, t in alone.tensors.items())
    assert len(behind.tensors["0.offsets"]) == 40
    assert wb.evaluate(behind, shape("star")).fp_rate < wb.evaluate(alone, shape("star")).fp_rate


def test_time_is_shared(monkeypatch, ticking):
    given = []
    ticking(0.01)
    real = networks._Fit.__init__

    def note(self, kind, problem, options, progress):
        given.append(options.budget)
        real(self, kind, problem, options, progress)

    monkeypatch.setattr(networks._Fit, "__init__", note)
    few("c", "aabb+learned-kdop+mlp", steps=None, budget=4.0)
    (left,) = given
    assert 2.0 < left <= 4.0


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
        few("c", method)


def test_parts_must_know_the_query():
    with pytest.raises((BounderError, QueryError)):
        few("blob", "voxels+mlp", query="ray")


@pytest.mark.parametrize(
    ("query", "name"),
    [
        ("point", "blob"),
        ("ray", "blob"),
        ("box", "c"),
        ("plane", "c"),
        pytest.param("ray", "animated", marks=pytest.mark.slow),
    ],
)
def test_more_half_spaces_than_kdop_has(query, name):
    usual, more = (few(name, "learned-kdop", query=query, k=k, steps=300) for k in (None, 40))
    assert len(more.tensors["offsets"]) in (40, len(usual.tensors["offsets"]))  # kdop's own where these are better
    assert more.certificate.proven
    rates = [wb.evaluate(b, shape(name), samples=100_000) for b in (usual, more)]
    assert rates[1].fn == 0
    assert rates[1].fp_rate <= 1.05 * rates[0].fp_rate


@pytest.mark.parametrize("k", [5, 13 - 2, 129, 0, -1])
def test_a_number_of_half_spaces_that_there_is_not(k):
    with pytest.raises(BounderError, match=f"up to 128, got {k}$"):
        few("blob", "learned-kdop", k=k)


def test_a_last_part_that_is_fitted_already_is_taken_as_it_is(monkeypatch):
    network, grid = few("star", "mlp", query="ray"), shape("star")
    monkeypatch.setattr(networks, "_Fit", None)
    whole = few("star", "learned-kdop+mlp", query="ray", last=network)
    assert whole.threshold == network.threshold
    assert len(whole.tensors["0.offsets"]) == 40
    assert whole.certificate.kind == network.certificate.kind
    assert whole.info["training"]["seconds"] > network.info["training"]["seconds"]
    assert wb.evaluate(whole, grid).fp_rate < wb.evaluate(network, grid).fp_rate


def test_a_last_part_that_does_not_belong_there_is_refused():
    network = few("star", "mlp")
    for method in ("mlp", "mlp+kdop", "kdop+mlp-early"):
        with pytest.raises(BounderError, match="last must be the last of several methods"):
            few("star", method, last=network)
    with pytest.raises(BounderError, match="same"):
        few("c", "kdop+mlp", last=network)
    with pytest.raises(BounderError, match="same queries and domain"):
        few("star", "kdop+mlp", query="ray", last=network)
