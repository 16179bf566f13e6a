"""``certify`` proves what ``prove`` proved, and finds every planted false negative."""

from dataclasses import replace

import numpy as np
import pytest
from bounding_shapes import (
    CONSERVATIVE,
    EARLY,
    SHAPES,
    crossed,
    fitted,
    object_points,
    random_bounder,
    random_mlp,
    shape,
)

import warp_bounding as wb
from warp_bounding.errors import BounderError
from warp_bounding.indicators import IndicatorGrid
from warp_bounding.proof import prove
from warp_bounding.queries.domain import Domain


def copy_of(bounder, tensors=None, domain=None):
    """A bounder that may be spoilt."""
    twin = type(bounder)(domain or bounder.domain, tensors or bounder.tensors, bounder.sizes, "cpu")
    twin.info = dict(bounder.info)
    return twin.freeze(float(bounder.threshold), bounder.certificate)


def check_refuted(bounder, grid):
    """Not proven; and a counterexample, where one is given, is one."""
    proof = wb.certify(bounder, grid)
    assert not proof.proven
    assert proof.kind in ("refuted", "undecided")
    if proof.kind == "refuted":
        x = np.float32([proof.counterexample])
        assert grid.contains(x)[0]
        assert bounder.query(x).numpy()[0] == 0
    return proof


@pytest.mark.parametrize(("method", "name"), crossed(CONSERVATIVE, SHAPES))
def test_certify_proves_what_prove_proved(method, name):
    bounder, grid = fitted(method, name), shape(name)
    proof = wb.certify(bounder, grid)
    assert proof.proven, proof.message
    assert proof.counterexample is None
    assert proof.cells == len(grid.occupied)
    assert proof.indicator == grid.digest == bounder.certificate.indicator
    assert proof.threshold == float(bounder.threshold) == bounder.certificate.threshold
    assert proof.lower_bound - proof.rounding_bound >= proof.threshold
    assert bounder.certificate.lower_bound - bounder.certificate.rounding_bound >= float(bounder.threshold)
    assert (np.array(proof.delta) >= 1 / 4096 * (1 - 1e-6)).all()


@pytest.mark.parametrize("query", ["ray", "plane", "box"])
@pytest.mark.parametrize("method", ["aabb", "obb", "kdop", "sphere", "bvh", "learned-kdop"])
def test_one_more_voxel_is_found_by_regions(method, query):
    grid = shape("c")
    occupancy = grid.occupancy.copy()
    corner = tuple(np.array(grid.shape) - 1)
    assert not occupancy[corner]
    occupancy[corner] = True
    more = IndicatorGrid(occupancy, cells_per_unit=grid.cells_per_unit, offset=grid.offset)
    options = {"steps": 20} if method == "learned-kdop" else {}
    bounder = wb.fit(grid, method=method, query=query, device="cpu", **options)
    assert wb.certify(bounder, grid).proven
    proof = wb.certify(bounder, more)
    assert proof.kind == "refuted", proof.message
    assert bounder.query(np.float32([proof.counterexample])).numpy()[0] == 0


@pytest.mark.parametrize("query", ["plane", "box"])
def test_regions_of_a_network_with_exits_are_proven_part_by_part(query):
    sizes = {"steps": 40, "hidden": EARLY, "device": "cpu"}
    bounder = wb.fit(shape("c"), method="mlp-early", query=query, **sizes)
    with pytest.raises(BounderError, match="part by part"):
        prove(bounder, shape("c"))


@pytest.mark.parametrize("method", CONSERVATIVE)
def test_a_raised_threshold_is_found(method):
    bounder, grid = copy_of(fitted(method, "blob")), shape("blob")
    bounder.freeze(np.float32(bounder.threshold + max(0.05, 0.05 * abs(bounder.threshold))), bounder.certificate)
    assert check_refuted(bounder, grid).kind == "refuted"


@pytest.mark.parametrize("method", ["kdop", "oriented-ellipsoid", "mlp"])
def test_a_threshold_raised_by_its_last_bits_is_not_proven(method):
    """Two rounding bounds more than what holds: the deployed answers may all be right, but there is no proof."""
    bounder = copy_of(fitted(method, "blob"))
    if method == "mlp":
        prove(bounder, shape("blob"), eps=1e-7)
    bounder.freeze(np.float32(float(bounder.threshold) + 2 * bounder.rounding_bound()), None)
    check_refuted(bounder, shape("blob"))


@pytest.mark.parametrize("method", CONSERVATIVE)
def test_one_changed_weight_is_found(method):
    bounder, grid = fitted(method, "blob"), shape("blob")
    name, index, change = {
        "aabb": ("low", 0, 0.2),
        "obb": ("high", 1, -0.2),
        "kdop": ("high", 4, -0.2),
        "sphere": ("offset", 2, 0.4),
        "ellipsoid": ("matrix", 1, 0.4),
        "oriented-ellipsoid": ("offset", 0, 0.4),
        "learned-kdop": ("offsets", 0, -0.2),
        "relu-field": ("values", int(np.argmax(bounder.tensors.get("values", 0))), -2.0),
        "mlp": ("layers.1.bias", 0, -0.1),
        "mlp-early": ("layers.2.bias", 0, -0.1),
        "voxels": ("summand", 0, 1.0),
        "bvh": ("low", -1, 0.1),
    }[method]
    tensor = bounder.tensors[name].copy()
    tensor.flat[index] += np.float32(change)
    spoilt = copy_of(bounder, bounder.tensors | {name: tensor})
    assert check_refuted(spoilt, grid).kind == "refuted"


def test_every_weight_of_a_network_counts():
    """Whatever is changed far enough for a sample to notice, ``certify`` notices."""
    grid, rng = shape("blob"), np.random.default_rng(0)
    bounder = copy_of(fitted("mlp", "blob"))
    x = object_points(grid, rng)
    noticed = 0
    for name in bounder.tensors:
        tensor = bounder.tensors[name].copy()
        tensor.flat[rng.integers(tensor.size)] += np.float32(rng.choice([-1.0, 1.0]))
        spoilt = copy_of(bounder, bounder.tensors | {name: tensor})
        if not spoilt.query(x).numpy().all():
            noticed += 1
            assert not wb.certify(spoilt, grid).proven
    assert noticed


@pytest.mark.parametrize("method", CONSERVATIVE)
def test_one_more_voxel_is_found(method):
    """Any empty cell that the bounder denies some of."""
    bounder, grid = fitted(method, "c"), shape("c")
    empty = np.argwhere(~grid.occupancy)
    denied = empty[bounder.query(grid.position(empty)).numpy() == 0]
    if not len(denied):
        pytest.skip(f"this {method} bounder, hardly trained, denies no cell of the shape")
    occupancy = grid.occupancy.copy()
    occupancy[tuple(denied[0])] = True
    proof = check_refuted(bounder, IndicatorGrid(occupancy))
    assert proof.kind == "refuted"
    assert proof.indicator != bounder.certificate.indicator


def test_one_bit_less_is_found():
    bounder, grid = fitted("voxels", "c"), shape("c")
    bits = bounder.tensors["bits"].copy()
    index = int(np.flatnonzero(grid.occupancy.ravel())[9])
    bits[index >> 5] ^= np.uint32(1 << (index & 31))
    assert check_refuted(copy_of(bounder, bounder.tensors | {"bits": bits}), grid).kind == "refuted"


@pytest.mark.parametrize("method", CONSERVATIVE)
def test_another_object_is_refuted(method):
    grid = IndicatorGrid(~shape("star").occupancy)  # all around it
    bounder = fitted(method, "star")
    answers = bounder.query(grid.position(grid.occupied)).numpy()
    if answers.all():
        pytest.skip(f"this {method} bounder, hardly trained, denies nothing")
    assert check_refuted(bounder, grid).kind == "refuted"


@pytest.mark.parametrize("other", ["c", "animated", "five"])
def test_a_shape_of_another_dimension_does_not_apply(other):
    proof = wb.certify(fitted("aabb", "blob"), shape(other))
    assert proof.kind == "inapplicable"
    assert "3D" in proof.message
    still = IndicatorGrid(shape("animated").occupancy)
    assert wb.certify(fitted("aabb", "animated"), still).kind == "inapplicable"


def test_a_shape_beyond_the_domain_is_refuted():
    grid = shape("blob")
    moved = IndicatorGrid(grid.occupancy, offset=[3.0, 0.0, 0.0])
    proof = check_refuted(fitted("aabb", "blob"), moved)
    assert proof.kind == "refuted"
    assert "domain" in proof.message
    with pytest.raises(BounderError, match="domain"):
        prove(copy_of(fitted("aabb", "blob")), moved)
    with pytest.raises(BounderError, match="2D"):
        prove(copy_of(fitted("aabb", "blob")), shape("c"))


LIES = {
    "delta": lambda d: {"delta": d.delta * 1e-6},
    "delta nan": lambda d: {"delta": d.delta * np.nan},
    "limit": lambda d: {"limit": d.limit * np.float32(0.5)},  # denies what lies beyond, and P_delta would be cut there
    "limit nan": lambda d: {"limit": d.limit * np.float32(np.nan)},
    "scale": lambda d: {"scale": -d.scale},  # boxes inside out
    "corner": lambda d: {"lower": d.lower - 1e9},
    "center": lambda d: {"center": d.center + np.float32(1e4)},
    "shape": lambda d: {"scale": d.scale[:1]},
}


@pytest.mark.parametrize("lie", LIES)
def test_a_domain_that_lies_does_not_apply(lie):
    bounder = fitted("aabb", "blob")
    lying = copy_of(bounder)
    lying.domain = replace(bounder.domain, **LIES[lie](bounder.domain))
    assert lying.domain.fault()
    proof = wb.certify(lying, shape("blob"))
    assert proof.kind == "inapplicable"
    assert "domain" in proof.message
    with pytest.raises(BounderError, match="domain"):
        prove(lying, shape("blob"))


def test_time_must_end_inside_its_range():
    bounder = fitted("aabb", "animated")
    domain = bounder.domain
    limit = domain.limit.copy()
    limit[0] = np.float32(1.01)
    assert domain.fault() is None
    assert replace(domain, limit=limit).fault()


@pytest.mark.parametrize("name", SHAPES)
def test_domains_that_are_made_are_faultless(name):
    assert Domain.of(shape(name)).fault() is None


def test_no_time_is_no_decision():
    grid, bounder = shape("blob"), random_mlp(shape("blob"), (25, 25), gain=8.0)
    prove(bounder, grid, eps=1e-4, boxes=1_000_000)
    proof = wb.certify(bounder, grid, seconds=0.0)
    assert proof.kind in ("undecided", "proven")
    assert proof.proven or "no decision within 0 s. Object: " in proof.message


@pytest.mark.parametrize("wrong", ["nowhere.npy", None, 3, np.zeros((2, 2))])
def test_what_is_no_shape_does_not_apply(wrong):
    proof = wb.certify(fitted("aabb", "blob"), wrong)
    assert proof.kind == "inapplicable"


def test_arrays_are_shapes():
    assert wb.certify(fitted("aabb", "star"), shape("star").occupancy).proven


def test_prove_reports_what_it_did():
    bounder = random_bounder("mlp", "blob")
    assert bounder.certificate is None
    search = prove(bounder, shape("blob"))
    certificate = bounder.certificate
    assert certificate.proven
    assert certificate.boxes == search.boxes
    assert certificate.lower_bound == search.lower_bound
    assert certificate.query == "point"
    assert "Proven" in certificate.message
    assert type(certificate).from_dict(certificate.to_dict()) == certificate
