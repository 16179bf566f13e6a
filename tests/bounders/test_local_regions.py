"""Thresholds of the parts of the domain for rays and boxes: proven part by part, never looser, and a part that lies is found out."""

from functools import cache

import numpy as np
import pytest
from bounding_shapes import random_mlp, shape

import warp_bounding as wb
from warp_bounding.bounders.mlp import EVERYWHERE, NOWHERE, Lattice, Local
from warp_bounding.errors import BounderError
from warp_bounding.proof import charted
from warp_bounding.proof.prove import corners, in_part, meeting
from warp_bounding.queries import sample
from warp_bounding.queries.hard import draw_positives
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.training import fit_network

PARTS = 16
QUERIES = {"ray": {"length": 0.6}, "box": {}}


@cache
def fit(query: str) -> wb.Bounder:
    options = {"hidden": (8,), "steps": 300, "thresholds": PARTS, "device": "cpu", "progress": False}
    return wb.fit(shape("c"), query, method="mlp", **options, **QUERIES[query])


def positives(bounder: wb.Bounder, count: int = 100_000, seed: int = 7) -> np.ndarray:
    grid, length = shape("c"), bounder.domain.oracle_length
    return np.concatenate(list(draw_positives(bounder.query_kind, grid, count, seed, "cpu", length)))


@pytest.mark.parametrize("query", ["ray", pytest.param("box", marks=pytest.mark.slow)])
def test_a_fit_is_proven_part_by_part_and_no_looser(query, tmp_path):
    bounder, grid = fit(query), shape("c")
    assert bounder.method == "local"
    assert bounder.certificate.proven
    assert 1 < bounder.lattice.count <= PARTS
    assert bounder.info["training"]["thresholds"] == bounder.lattice.count
    met = positives(bounder)
    assert bounder.query(met).numpy().all()
    assert wb.evaluate(bounder, grid, samples=50_000).fn == 0
    finite = np.isfinite(bounder.thresholds)
    assert np.ptp(bounder.thresholds[finite]) > 0.05
    single = bounder.member.to("cpu").freeze(bounder.thresholds[finite].min() + float(bounder.threshold), None)
    x = sample(query, grid, 20_000, np.random.default_rng(3)).astype(np.float32)
    asked = finite[bounder.lattice.place(bounder.domain.to_local(x))]
    assert (bounder.query(x).numpy() <= single.query(x).numpy())[asked].all()
    assert bounder.query(x).numpy().sum() < single.query(x).numpy().sum()
    bounder.save(tmp_path / "local.safetensors")
    again = wb.load(tmp_path / "local.safetensors", device="cpu")
    assert again.certificate == bounder.certificate
    assert (again.query(x).numpy() == bounder.query(x).numpy()).all()
    assert wb.certify(again, grid).proven


@pytest.mark.slow
@pytest.mark.parametrize("query", QUERIES)
def test_a_part_that_denies_a_positive_is_found_out(query):
    bounder, grid = fit(query), shape("c")
    levels = bounder.tensors["levels"].view(np.uint8)[: bounder.lattice.count]
    met = positives(bounder)
    places = bounder.lattice.place(bounder.domain.to_local(met))
    told = (np.bincount(places, minlength=len(levels)) > 0) & (levels < EVERYWHERE)
    lowest = np.argmin(np.where(told, levels, NOWHERE))
    highest = np.argmax(np.where(told, levels, 0))
    tried = [(lowest, NOWHERE), (lowest, EVERYWHERE - 1), (highest, NOWHERE)]
    step = float(bounder.tensors["scale"][1])
    for part in np.flatnonzero(told):  # raised by just as much as makes it deny a positive that was drawn
        least = bounder.values(met[places == part]).numpy().min()
        raised = int(levels[part]) + int(np.ceil((least - float(bounder.threshold)) / step)) + 1
        tried += [(part, raised)] if raised < EVERYWHERE else []
    assert len(tried) > 3
    for part, wrong in tried:
        assert levels[part] < wrong
        changed = levels.copy()
        changed[part] = wrong
        words = np.pad(changed, (0, -len(changed) % 4)).view(np.uint32)
        lying = Local(bounder.domain, bounder.tensors | {"levels": words}, bounder.sizes, "cpu")
        lying.freeze(bounder.threshold, None).info = bounder.info
        assert not lying.query(met[places == part]).numpy().all()
        certificate = wb.certify(lying, grid)
        assert certificate.kind in ("refuted", "undecided")
        if wrong >= EVERYWHERE - 1:
            assert certificate.kind == "refuted"
            assert not lying.query(np.float32([certificate.counterexample])).numpy().any()


def test_nothing_is_proven_where_all_is_denied_or_nothing_in_time():
    bounder, grid = fit("ray"), shape("c")
    nowhere = np.full_like(bounder.tensors["levels"], 0xFFFFFFFF)
    lying = Local(bounder.domain, bounder.tensors | {"levels": nowhere}, bounder.sizes, "cpu")
    for threshold in (0.0, -(2.0**127.5), 2.0**127.5):
        lying.freeze(threshold, None).info = bounder.info
        assert wb.certify(lying, grid).kind == "refuted" or threshold < 0
        assert not wb.certify(lying, grid).proven
    assert wb.certify(bounder, grid, seconds=0).kind == "undecided"


@pytest.mark.slow
def test_a_proof_without_time_is_told(monkeypatch):
    monkeypatch.setattr(fit_network, "REGION_PROOF_BOXES", 100)
    monkeypatch.setattr(fit_network, "LARGEST_COST", -1.0)
    options = {"hidden": (16,), "steps": 200, "thresholds": 8, "device": "cpu", "progress": False}
    bounder = wb.fit(shape("c"), "ray", **options, length=0.6)
    assert bounder.certificate.kind == "statistical"
    assert "Statistical, not proven" in bounder.certificate.message
    assert "A proof did not end" in bounder.certificate.message
    assert not bounder.info["training"]["complete"]


@pytest.mark.parametrize("name", ["c", "blob"])
@pytest.mark.parametrize("query", QUERIES)
def test_a_part_bounds_the_queries_in_it_and_no_others(query, name, rng):
    member = random_mlp(shape(name), domain=domain_of(shape(name), query, **QUERIES[query]))
    cover, limit = charted(member, shape(name)), member.domain.limit.astype(np.float64)
    lattice = Lattice.of(-0.7 * limit, 0.6 * limit, (2,) * len(limit))
    row = rng.integers(len(cover.lower), size=300)
    share = np.sort(rng.random((2, 300, cover.lower.shape[1])), axis=0)
    lower, upper = (cover.lower[row] + s * (cover.upper - cover.lower)[row] for s in share)
    z = lower + rng.random((50, *lower.shape)) * (upper - lower)
    v = np.stack([cover.coordinates(each) for each in z])
    low, high = cover.chart.hull(lower, upper, cover.numbers)
    assert ((low <= v) & (v <= high)).all()
    f = np.stack([member.reference(each) for each in v])
    plain = cover.bound(lower, upper)
    # The chart leaves out what is no query of the domain, and boxes that do not meet the object.
    held = ((np.abs(v) <= limit).all(axis=2) & np.isfinite(plain.lower)).T
    held &= _positive(cover, query, z).T
    tighter, place = 0, np.stack([lattice.place(each) for each in v]).T
    for part, (first, last) in enumerate(zip(*corners(lattice), strict=True)):
        bounds = in_part(cover, first, last).bound(lower, upper)
        inside = held & (place == part)
        some = inside.any(axis=1)
        assert np.isfinite(bounds.lower[some]).all()
        least = np.where(inside, f.T, np.inf).min(axis=1)
        assert (bounds.lower[some] <= least[some]).all()
        tighter += int((bounds.lower > plain.lower + 1e-6).sum())
    assert tighter > 100
    met = {part for part, _ in meeting(cover, lattice)}
    assert set(np.unique(lattice.place(v.reshape(-1, v.shape[2])[held.T.reshape(-1)]))) <= met


def _positive(cover, query: str, z: np.ndarray) -> np.ndarray:
    """Which numbers are queries that meet the object: of rays all; of boxes those whose corners are in order and that do."""
    if query == "ray":
        return np.ones(z.shape[:2], dtype=bool)
    flat = z.reshape(-1, z.shape[2])
    return np.isfinite(cover.bound(flat, flat).lower).reshape(z.shape[:2]) & (
        z[..., : z.shape[2] // 2] <= z[..., z.shape[2] // 2 :]
    ).all(axis=2)


def test_what_a_fit_refuses():
    with pytest.raises(BounderError, match="thresholds"):
        wb.fit(shape("c"), "plane", thresholds=4, steps=1, device="cpu", progress=False)
    with pytest.raises(BounderError, match="thresholds"):
        wb.fit(shape("c"), "box", "monotone-mlp", thresholds=4, steps=1, device="cpu", progress=False)
