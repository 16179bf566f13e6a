"""Bounders of a shape itself together with bounders of its cells: parts in domains of their own."""

import dataclasses
import json
import struct
from functools import cache

import numpy as np
import pytest
import trimesh
import warp as wp
from asking import ask, check_compiles
from safetensors import safe_open

import warp_bounding as wb
from warp_bounding.bounders.composition.composition import Composition
from warp_bounding.bounders.composition.moves import common_domain, moves_of
from warp_bounding.bounders.file_format import digest_of
from warp_bounding.coordinates.domain import Domain
from warp_bounding.errors import BounderError, FileFormatError
from warp_bounding.kernels.functions import batch_kernel

STEPS = 150
OF_CELLS = {"bvh": {"leaves": 30}, "voxels": {"resolution": 20}, "mlp-cells": {"method": "mlp", "resolution": 24}}


@cache
def shape(name: str = "mesh"):
    ring = trimesh.creation.torus(1.0, 0.35).apply_translation([3.0, 0.0, -1.0])
    if name == "mesh":
        return wb.load_indicator(ring)
    frames = [ring.vertices * size + [shift, 0, 0] for size, shift in ((1.0, 0.0), (1.2, 0.3))]
    return wb.IndicatorMotion(np.array(frames), ring.faces, times=[0.0, 2.0])


@cache
def fitted(method: str, of: str = "mesh") -> wb.Bounder:
    options = {"method": method} | OF_CELLS.get(method, {})
    if options["method"] == "mlp":
        options |= {"hidden": (12, 12), "steps": STEPS}
    if of == "motion" and method in OF_CELLS:
        options |= {"resolution": 12}
    bounder = wb.fit(shape(of), device="cpu", progress=False, **options)
    assert bounder.certificate.proven
    return bounder


@cache
def points(of: str = "mesh", count: int = 100_000) -> np.ndarray:
    lower, upper = shape(of).lower, shape(of).upper
    reach = 0.1 * shape(of).extent.max()
    return np.random.default_rng(0).uniform(lower - reach, upper + reach, (count, len(lower))).astype(np.float32)


def maybe(bounder, x) -> np.ndarray:
    return bounder.query(x).numpy() == 1


def check(whole, want, x, truth):
    """Its answers are those of its parts in the domain of the shape, and nothing else."""
    found = maybe(whole, x)
    assert whole.certificate.proven
    assert whole.certificate.resolution is None
    assert not (truth & ~found).any()
    within = (np.abs(whole.domain.to_local(x)) <= whole.domain.limit * (1 - 1e-6)).all(axis=1)
    assert (found[within] == want[within]).mean() > 0.9999  # but for rounding
    if not whole.domain.time:
        assert not found[(np.abs(whole.domain.to_local(x)) > whole.domain.limit * (1 + 1e-6)).any(axis=1)].any()
    plain = maybe(whole.to("cpu", native=False), x[:5000])
    assert (plain == found[:5000]).mean() > 0.999


@pytest.mark.parametrize("cells", OF_CELLS)
def test_a_network_of_the_mesh_and_a_bounder_of_its_cells(cells, tmp_path):
    one, other, x = fitted("mlp"), fitted(cells), points()
    truth = shape().contains(x)
    for whole, want in (
        (one & other, maybe(one, x) & maybe(other, x)),
        (other & one, maybe(one, x) & maybe(other, x)),
        (other | one, maybe(one, x) | maybe(other, x)),
    ):
        check(whole, want, x, truth)
        assert whole.certificate.indicator == shape().digest
        assert wb.certify(whole, shape()).proven
        whole.save(tmp_path / "w.safetensors")
        again = wb.load(tmp_path / "w.safetensors", device="cpu")
        assert (maybe(again, x) == maybe(whole, x)).all()
        assert wb.certify(again, shape()).proven
        assert again.certificate == whole.certificate
        rates = wb.evaluate(again, shape(), samples=20_000)
        assert rates.fn == 0
        assert rates.fp_rate_cells is None


def test_nested_and_asked_in_a_kernel():
    whole = (fitted("voxels") & fitted("mlp")) | (fitted("kdop") & fitted("bvh") & fitted("mlp-cells"))
    x = points()
    first, second = (
        maybe(fitted("voxels"), x) & maybe(fitted("mlp"), x),
        maybe(fitted("kdop"), x) & maybe(fitted("bvh"), x) & maybe(fitted("mlp-cells"), x),
    )
    check(whole, first | second, x, shape().contains(x))
    assert wb.certify(whole, shape()).proven

    answers = ask(whole, x).astype(bool)
    assert (answers == maybe(whole, x)).mean() > 0.9999
    assert not (shape().contains(x) & ~answers).any()


def test_a_placed_shape_and_what_its_certificate_covers():
    whole, x = fitted("mlp") & fitted("bvh"), points()
    way = np.float32([0.5, -0.25, 2.0])
    place = wp.transform(wp.vec3(*way), wp.quat_identity())
    denied = whole.query(x + way, xform=place).numpy() == 0
    assert denied.any()
    assert not (shape().contains(x) & denied).any()
    assert (np.array(whole.certificate.placement) < np.array(fitted("mlp").certificate.placement)).all()
    far = wp.transform(wp.vec3(500.0, 0.0, 0.0), wp.quat_identity())
    with pytest.raises(wb.QueryError, match="the certificate covers"):
        whole.query(x.astype(np.float64), xform=far)


@pytest.mark.slow
def test_of_a_motion_up_to_the_ends_of_its_times():
    whole, x = fitted("kdop", "motion") & fitted("bvh", "motion"), points("motion").copy()
    x[: len(x) // 2, 0] = np.random.default_rng(1).choice([0.0, 1e-6, 2.0 - 1e-6, 2.0, -0.1, 2.1], len(x) // 2)
    truth = shape("motion").contains(x)
    check(whole, maybe(fitted("kdop", "motion"), x) & maybe(fitted("bvh", "motion"), x), x, truth)
    assert (maybe(whole, x) == 1)[(x[:, 0] < 0) | (x[:, 0] > 2)].all()
    assert wb.certify(whole, shape("motion")).proven


def test_a_part_that_denies_something_is_refuted():
    low = fitted("bvh").to("cpu")
    low = low.freeze(float(low.threshold) + 0.3, low.certificate)
    assert wb.certify(fitted("mlp") & low, shape()).kind == "refuted"


def test_the_maps_are_right_and_their_error_is_bounded():
    whole, part = fitted("mlp").domain, fitted("bvh").domain
    common = common_domain(whole, [part])
    assert (common.delta <= whole.delta).all()
    assert (common.delta < whole.delta).any()
    moves = moves_of(common, [common, part])
    x = np.random.default_rng(0).uniform(shape().lower, shape().upper, (100_000, 3)).astype(np.float32)
    v = (x - common.center) * common.scale
    got = v * moves.ratio[1] + moves.shift[1]
    assert got.dtype == np.float32
    off = np.abs(got - part.to_local(x.astype(np.float64))).max(axis=0)
    assert (off <= part.delta).all()
    assert (np.abs(moves.of(1, common.to_local(x)) - part.to_local(x.astype(np.float64))) <= moves.error[1]).all()
    assert (moves.error[0] == 0).all()
    assert (moves.ratio[0] == 1).all()


def test_what_cannot_be_put_together_is_refused_in_one_line(tmp_path):
    with pytest.raises(BounderError, match="one bounder of the shape itself, or cells of one resolution"):
        fitted("bvh") & fitted("voxels")
    with pytest.raises(BounderError, match="same object, got the shape"):
        wb.fit(shape().to_grid(resolution=8).occupancy, method="aabb", device="cpu") & fitted("voxels")
    moved = wb.load_indicator(trimesh.creation.torus(1.0, 0.3))
    with pytest.raises(BounderError, match="same object, got the shape"):
        wb.fit(moved, method="aabb", device="cpu") & fitted("voxels")
    with pytest.raises(BounderError, match="same object, got margin"):
        wb.fit(shape(), method="aabb", margin=0.1, device="cpu") & fitted("voxels")
    older = fitted("voxels").to("cpu")
    older.info = fitted("voxels").info | {"shape": None}
    with pytest.raises(BounderError, match=r"of whose cells these bound is not known|same object, got the shape"):
        older & fitted("mlp")
    boxes = wb.fit(shape(), "box", "bvh", leaves=8, device="cpu", progress=False)
    with pytest.raises(BounderError, match="points of one bounded object"):
        wb.fit(shape(), "box", "aabb", device="cpu", progress=False) & boxes


def edited(path, change):
    """The file with its document changed, and a digest that is right again."""
    with safe_open(path, "np") as file:
        tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
        document = json.loads(file.metadata()["warp_bounding"])["bounder"]
    change(document)
    text = json.dumps({"sha256": digest_of(tensors, document), "bounder": document})
    raw = path.read_bytes()
    size = struct.unpack("<Q", raw[:8])[0]
    header = json.loads(raw[8 : 8 + size])
    header["__metadata__"] = {"warp_bounding": text}
    head = json.dumps(header).encode()
    path.write_bytes(struct.pack("<Q", len(head)) + head + raw[8 + size :])


def narrow(document):
    entry = next(e for e in document["sizes"]["parts"] if e.get("resolution"))
    entry["domain"]["delta"] = [x / 4 for x in entry["domain"]["delta"]]


def shifted(document):
    next(e for e in document["sizes"]["parts"] if e.get("resolution"))["domain"]["center"] = [0.1, 0.0, 0.0]


def no_domain(document):
    document["sizes"]["parts"][0]["domain"] = [1, 2]


def no_resolution(document):
    next(e for e in document["sizes"]["parts"] if e.get("resolution"))["resolution"] = "fine"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (narrow, "does not cover the rounding"),
        (shifted, "the domain of part"),
        (no_domain, "the domain of part 0 is none"),
        (no_resolution, "the resolution of part"),
    ],
)
def test_a_file_that_contradicts_itself_is_refused(change, message, tmp_path):
    path = tmp_path / "w.safetensors"
    (fitted("mlp") & fitted("bvh")).save(path)
    wb.load(path, device="cpu")
    edited(path, lambda document: None)
    wb.load(path, device="cpu")
    edited(path, change)
    with pytest.raises(FileFormatError, match=message):
        wb.load(path, device="cpu")


def part_elsewhere(document):
    """The part's boxes moved by a twentieth of the ring, in a domain that holds it all the same."""
    domain = next(e for e in document["sizes"]["parts"] if e.get("resolution"))["domain"]
    domain["center"][0] = float(np.float32(domain["center"][0] - 0.05))
    domain["limit"] = [2.0, 2.0, 2.0]
    document["domain"]["delta"] = [x / 2 for x in document["domain"]["delta"]]
    document["certificate"]["placement"] = [0.0, 0.0, 0.0]


def coarser_cells(document):
    next(e for e in document["sizes"]["parts"] if e.get("resolution"))["resolution"] = 8


def cells_forgotten(document):
    for entry in document["sizes"]["parts"]:
        entry.pop("resolution", None)


@pytest.mark.parametrize("lie", [part_elsewhere, coarser_cells])
def test_a_lie_about_a_part_is_found_out_by_certify(lie, tmp_path):
    path = tmp_path / "w.safetensors"
    (fitted("mlp") & fitted("bvh")).save(path)
    edited(path, lie)
    assert wb.certify(wb.load(path, device="cpu"), shape()).kind in ("refuted", "undecided")


def test_a_part_of_cells_that_claims_the_shape_itself_is_not_asked_about_cells(tmp_path):
    path = tmp_path / "w.safetensors"
    (fitted("mlp") & fitted("bvh")).save(path)
    edited(path, cells_forgotten)
    assert wb.certify(wb.load(path, device="cpu"), shape()).kind == "inapplicable"  # cells are what it is proven over


@pytest.mark.slow
def test_a_tree_and_a_bounder_of_cells():
    tree = wb.hierarchy(shape(), method="kdop", leaves=4, device="cpu", progress=False)
    x = points()
    whole = (tree & fitted("bvh")) | fitted("mlp")
    check(whole, (maybe(tree, x) & maybe(fitted("bvh"), x)) | maybe(fitted("mlp"), x), x, shape().contains(x))
    assert wb.certify(whole, shape()).proven


def test_parts_of_one_domain_are_as_before():
    whole = Composition.of(["or", 0, 1], [fitted("kdop"), fitted("mlp")])
    assert whole.moves is None
    assert whole.domain is fitted("kdop").domain or isinstance(whole.domain, Domain)
    assert all("domain" not in entry for entry in whole.sizes["parts"])


def test_cuda_source_compiles(tmp_path):
    if not hasattr(wp, "compile_aot_module"):
        pytest.skip("this Warp cannot compile ahead of time")
    whole = (fitted("mlp") & fitted("bvh")) | fitted("voxels")
    check_compiles(batch_kernel(whole.source, False, False), tmp_path)


def test_what_its_own_domain_leaves_out_is_found():
    """A composition is asked in its own domain before any of its parts: theirs may hold the object, and its own not."""
    one, other = fitted("aabb"), fitted("kdop")
    whole, domain = one | other, one.domain
    low, high = shape().lower, shape().upper
    small = Domain.of(wb.solids.Box(low, (low + high) / 2))
    small = dataclasses.replace(small, delta=np.minimum(small.delta, domain.delta / 8))
    assert small.fault() is None
    parts = [
        entry | {"domain": part.domain.to_dict()}
        for entry, part in zip(whole.sizes["parts"], (one, other), strict=True)
    ]
    lie = Composition(small, dict(whole.tensors), whole.sizes | {"parts": parts}, "cpu")
    lie.info = dict(whole.info)
    lie.freeze(0.0, None)
    assert (maybe(whole, points()) & ~maybe(lie, points())).any()
    assert wb.certify(whole, shape()).kind == "proven"
    found = wb.certify(lie, shape())
    assert found.kind in ("refuted", "undecided")
    assert found.message.startswith("the shape reaches outside the domain")
