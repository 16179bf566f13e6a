"""``certify`` proves what ``prove`` proved, finds every planted false negative, and takes no claim for another one."""

import dataclasses
import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import trimesh
from bounding_shapes import CONSERVATIVE, SHAPES, crossed, fitted, random_bounder, random_mlp, shape
from plain_shapes import ball_at, box_of
from rewriting import changed, check_refuted, rewrite

import warp_bounding as wb
from warp_bounding.certificates import ABOUT
from warp_bounding.certificates.claim import as_fitted, mismatch
from warp_bounding.errors import BounderError, BoundingError, FileFormatError, QueryError
from warp_bounding.proof import prove, settle
from warp_bounding.queries.domain import Domain, rounding_of_map
from warp_bounding.queries.placement import Placement, placement_error
from warp_bounding.shapes import Grid
from warp_bounding.shapes.shape import IN

MESH = wb.shapes.Mesh(*(lambda m: (m.vertices, m.faces))(trimesh.creation.box(extents=(1, 1, 2))), name="brick.obj")


def edited(bounder, path, change):
    """The path of its file, in which the description was changed, and its digest made right again."""
    bounder.save(path)
    rewrite(path, change)
    return path


# --- planted false negatives -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("method", "name"), crossed(CONSERVATIVE, ("c", "blob", "single", "mesh", "animated", "five")))
def test_certify_proves_what_prove_proved(method, name):
    bounder, grid = fitted(method, name), shape(name)
    proof = wb.certify(bounder, grid)
    assert proof.proven, proof.message
    assert proof.counterexample is None
    assert proof.cells == len(grid.occupied)
    assert proof.indicator == grid.digest == bounder.certificate.indicator
    assert proof.threshold == float(bounder.threshold) == bounder.certificate.threshold
    for certificate in (proof, bounder.certificate):
        assert certificate.lower_bound - certificate.rounding_bound >= float(bounder.threshold)
    assert (np.array(proof.delta) >= 1 / 4096 * (1 - 1e-6)).all()


CHANGES = {  # tensor, entry, by how much
    "aabb": ("low", 0, 0.2),
    "obb": ("high", 1, -0.2),
    "kdop": ("high", 4, -0.2),
    "sphere": ("offset", 2, 0.4),
    "ellipsoid": ("matrix", 1, 0.4),
    "oriented-ellipsoid": ("offset", 0, 0.4),
    "learned-kdop": ("offsets", 0, -0.2),
    "relu-field": ("values", None, -2.0),
    "mlp": ("layers.1.bias", 0, -0.1),
    "voxels": ("summand", 0, 1.0),
    "bvh": ("low", -1, 0.1),
}


@pytest.mark.parametrize("method", CONSERVATIVE)
def test_what_is_spoilt_is_refuted(method):
    """A raised threshold, a changed weight, one more voxel, another object."""
    bounder, grid = fitted(method, "blob"), shape("blob")
    raised = np.float32(bounder.threshold + max(0.05, 0.05 * abs(bounder.threshold)))
    check_refuted(bounder.to("cpu").freeze(raised, bounder.certificate), grid)
    name, index, change = CHANGES[method]
    tensor = bounder.tensors[name].copy()
    tensor.flat[int(np.argmax(tensor)) if index is None else index] += np.float32(change)
    check_refuted(changed(bounder, {name: tensor}, bounder.certificate), grid)
    denied = grid.position(np.argwhere(~grid.occupancy))
    denied = np.argwhere(~grid.occupancy)[bounder.query(denied).numpy() == 0]
    if len(denied):  # a network that is hardly trained may deny no cell
        occupancy = grid.occupancy.copy()
        occupancy[tuple(denied[0])] = True
        assert check_refuted(bounder, Grid(occupancy)).indicator != bounder.certificate.indicator
        check_refuted(bounder, Grid(~grid.occupancy))


@pytest.mark.parametrize("query", ["ray", "plane", "box"])
@pytest.mark.parametrize("method", ["kdop", "bvh", "learned-kdop"])
def test_one_more_voxel_is_found_by_regions(method, query):
    grid = shape("c")
    occupancy = grid.occupancy.copy()
    occupancy[tuple(np.array(grid.shape) - 1)] = True
    more = Grid(occupancy, cells_per_unit=grid.cells_per_unit, offset=grid.offset)
    options = {"steps": 20} if method == "learned-kdop" else {}
    bounder = wb.fit(grid, method=method, query=query, device="cpu", **options)
    assert wb.certify(bounder, grid).proven
    check_refuted(bounder, more)


@pytest.mark.parametrize("method", ["kdop", "oriented-ellipsoid", "mlp"])
def test_a_threshold_raised_by_its_last_bits_is_not_proven(method):
    """Two rounding bounds more than what holds: the deployed answers may all be right, but there is no proof."""
    bounder = fitted(method, "blob").to("cpu")
    if method == "mlp":
        prove(bounder, shape("blob"), eps=1e-7)
    bounder.freeze(np.float32(float(bounder.threshold) + 2 * bounder.rounding_bound()), None)
    check_refuted(bounder, shape("blob"), ("refuted", "undecided"))


def test_prove_reports_what_it_did_and_parts_are_proven_one_by_one():
    bounder = random_bounder("mlp", "blob")
    search, certificate = prove(bounder, shape("blob")), bounder.certificate
    assert certificate.proven
    assert (certificate.boxes, certificate.lower_bound) == (search.boxes, search.lower_bound)
    assert type(certificate).from_dict(json.loads(json.dumps(certificate.to_dict()))) == certificate
    boxes = wb.cascade(*(wb.fit(shape("c"), "box", method, device="cpu") for method in ("aabb", "kdop")))
    with pytest.raises(BounderError, match="part by part"):
        prove(boxes, shape("c"))


def test_no_time_is_no_decision():
    grid, bounder = shape("blob"), random_mlp(shape("blob"), (24, 24), gain=8.0)
    prove(bounder, grid, eps=1e-4, boxes=300_000)
    proof = wb.certify(bounder, grid, budget=0.0)
    assert proof.proven or (proof.kind, proof.message[:24]) == ("undecided", "no decision within 0 s. ")


# --- shapes and domains that are others ------------------------------------------------------------------------------


def test_another_shape_does_not_apply_or_is_refuted():
    bounder, grid = fitted("aabb", "blob"), shape("blob")
    for other in ("c", "animated", "five"):
        assert wb.certify(bounder, shape(other)).kind == "inapplicable"
    still = Grid(shape("animated").occupancy)
    assert wb.certify(fitted("aabb", "animated"), still).kind == "inapplicable"
    moved = Grid(grid.occupancy, offset=[3.0, 0.0, 0.0])
    assert "domain" in check_refuted(bounder, moved).message
    for shape_, words in ((moved, "domain"), (shape("c"), "2D")):
        with pytest.raises(BounderError, match=words):
            prove(bounder.to("cpu"), shape_)
    for wrong in ("nowhere.npy", None, 3, np.zeros((2, 2))):
        assert wb.certify(bounder, wrong).kind == "inapplicable"
    assert wb.certify(fitted("aabb", "star"), shape("star").occupancy).proven


def test_a_domain_that_is_false_does_not_apply():
    """Others are in the lies below, and in the files that are refused."""
    spoilt, domain = fitted("aabb", "blob").to("cpu"), fitted("aabb", "animated").domain
    spoilt.domain = replace(spoilt.domain, delta=spoilt.domain.delta * 1e-6)
    assert wb.certify(spoilt, shape("blob")).kind == "inapplicable"
    with pytest.raises(BounderError, match="domain"):
        prove(spoilt, shape("blob"))
    limit = domain.limit.copy()  # time must end inside its range
    limit[0] = np.float32(1.01)
    assert replace(domain, limit=limit).fault()
    assert all(Domain.of(shape(name)).fault() is None for name in SHAPES)


def test_a_domain_far_beyond_limits_of_joints_is_refuted_and_no_error():
    elbow = np.eye(4)
    elbow[0, 3] = 0.6
    links = [wb.arms.Body.capsule([0, 0, 0], [0.6, 0, 0], 0.06, link=k) for k in range(2)]
    arm = wb.arms.Arm([wb.arms.Joint(lower=-2.0, upper=2.5), wb.arms.Joint(elbow, lower=-2.2, upper=2.2)], links)
    cell = wb.arms.ArmConfigurations(arm, [wb.arms.Body.sphere([0.9, 0.2, 0], 0.2)])
    domain = Domain.of(cell)
    center, half = (domain.upper + domain.lower) / 2, 256 * (domain.upper - domain.lower) / 2
    far = replace(domain, lower=center - half, upper=center + half, scale=domain.scale / np.float32(256))
    claimed = dataclasses.replace(wb.fit(cell, method="aabb", device="cpu").certificate, threshold=1e3)
    bounder = random_mlp(cell, domain=far).freeze(1e3, claimed)
    assert wb.certify(bounder, cell, budget=5).kind == "refuted"


# --- what a claim is about -------------------------------------------------------------------------------------------


@cache
def bounder_of(query="point", margin=0.1):
    """Never change it."""
    options = {"length": 0.75} if query == "ray" else {}
    return wb.fit(MESH, method="aabb", device="cpu", query=query, margin=margin, resolution=8, **options)


EXPECTED = [
    ("point", {"margin": 0.2}, ("margin 0.2", "margin 0.1")),
    ("point", {"margin": 0.0}, ("margin 0.0", "margin 0.1")),
    ("point", {"margin": np.float32(0.1)}, ("0.10000000149011612", "margin 0.1")),  # a little more
    ("point", {"margin": np.nan}, ()),
    ("point", {"margin": np.inf}, ()),
    ("ray", {"length": 2.0}, ("length 2.0", "length 0.75")),
    ("point", {"length": 1.0}, ("length 1.0", "length none")),
    ("box", {"resolution": 64}, ("resolution 64", "resolution 8")),
    ("box", {"query": "ray"}, ("query ray", "query box")),
    ("ray", {"margin": 0.1, "length": 0.75000001}, ("length 0.75000001", "length 0.75")),
]


def test_another_claim_than_the_expected_one_is_not_proven():
    for query, expected, words in EXPECTED:
        bounder = bounder_of(query)
        proof = wb.certify(bounder, MESH, **expected)
        assert proof.kind == "inapplicable"
        assert proof.indicator == bounder.info["indicator"]
        assert all(word in proof.message for word in words)
    for wrong in ({"margin": "0.1"}, {"length": [0.75]}, {"resolution": True}):
        with pytest.raises(wb.BoundingError, match=f"^{next(iter(wrong))} must be a number, got"):
            wb.certify(bounder_of(), MESH, **wrong)


@pytest.mark.parametrize("query", ["point", "ray", "plane", "box"])
def test_certificates_say_what_they_are_about(query):
    bounder, length = bounder_of(query), 0.75 if query == "ray" else None
    expected = {"query": query, "margin": np.float64(0.1), "resolution": np.int64(8), "length": length}
    for certificate in (bounder.certificate, wb.certify(bounder, MESH, **expected)):
        assert certificate.proven
        about = (certificate.object, certificate.margin, certificate.length, certificate.resolution)
        assert about == ("brick.obj", 0.1, length, 8)
        assert type(certificate).from_dict(json.loads(json.dumps(certificate.to_dict()))) == certificate


def test_a_claim_edited_in_a_file_is_told_or_found_out(tmp_path):
    """A field that is edited in both places is another claim, which the message names; edited in one it is refused."""
    path = tmp_path / "b.safetensors"

    def smaller(document):
        for part in (document, document["certificate"], document["domain"]):
            part["length"] = 0.5

    false = wb.load(edited(bounder_of("ray"), path, smaller), device="cpu")
    proof = wb.certify(false, MESH)
    assert proof.proven
    assert proof.length == 0.5
    assert not wb.certify(false, MESH, length=0.75).proven
    # files of older versions hold none of what a certificate is about; it stands beside it
    older = edited(bounder_of("ray"), path, lambda d: [d["certificate"].pop(name) for name in ABOUT])
    old = wb.load(older, device="cpu")
    assert [getattr(old.certificate, name) for name in ABOUT] == [None] * len(ABOUT)
    assert wb.certify(old, MESH, margin=0.1, length=0.75).proven
    assert not wb.certify(old, MESH, margin=0.2).proven


@pytest.mark.parametrize("query", ["point", "ray", "plane", "box"])
def test_the_limit_of_placements_is_the_one_that_is_kept(query):
    """A placement that rounds by less is taken, one that rounds by more is refused: both sides of the number."""
    bounder, matrix, seen = bounder_of(query), np.eye(4), set()
    domain, limit = bounder.domain, np.array(bounder.certificate.placement)
    behind = rounding_of_map(domain.base.limit.astype(np.float64)) if query == "point" else 0.0
    for far in 10.0 ** np.linspace(0, 9, 40):
        matrix[:3, 3] = far
        placement = Placement.of(domain, matrix, None)
        needed = (placement_error(domain, placement.world, double=True) - behind) / domain.base.scale
        try:
            placement.check(domain, double=True)
            assert (needed <= limit * (1 + 1e-6)).all()
            seen.add("taken")
        except QueryError:
            assert (needed > limit * (1 - 1e-6)).any()
            seen.add("refused")
    assert seen == {"taken", "refused"}


# --- one thing said, another one asked about --------------------------------------------------------------------------

BOX = trimesh.creation.box(extents=(1.0, 1.2, 0.8))
MARGIN = 0.125
FRAMES = np.stack([BOX.vertices, BOX.vertices + np.array([0.25, 0, 0]), BOX.vertices]).astype(np.float32)
CUBES = np.zeros((6, 6, 6), bool)
CUBES[1:4, 2:4, 1:5] = True


@cache
def thing(name: str):
    """A mesh, its cells, a motion, a solid, and a function whose distance is too short."""
    if name == "motion":
        return wb.shapes.MovingMesh(FRAMES, BOX.faces, times=[0.0, 1.0, 2.0], time_cells=4)
    if name == "grid":
        return wb.shapes.Grid(CUBES)
    if name == "solid":
        return box_of([-0.5, -0.6, -0.4], [0.5, 0.6, 0.4])
    if name == "function":
        return wb.shapes.Function(
            None, [-1, -1, -1], [1, 1, 1], distance=lambda x: 0.5 * (np.linalg.norm(x, axis=1) - 1)
        )
    return wb.shapes.Mesh(BOX.vertices, BOX.faces)


KINDS = {  # of bounders: shape, and what ``fit`` is told
    "points": ("mesh", {"method": "aabb"}),
    "points of a grid": ("grid", {"method": "kdop"}),
    "points of a solid": ("solid", {"method": "obb"}),
    "points of a function": ("function", {"method": "aabb"}),
    "points of a motion": ("motion", {"method": "aabb"}),
    "cells": ("mesh", {"method": "aabb", "resolution": 8}),
    "rays": ("mesh", {"query": "ray", "method": "aabb", "length": 0.5}),
    "planes": ("mesh", {"query": "plane", "method": "aabb"}),
    "distance": ("mesh", {"query": "distance", "method": "aabb"}),
    "cascade": ("mesh", {"method": "sphere+aabb"}),
}


@cache
def of_kind(kind: str):
    """Proven, with a margin; never change it."""
    name, told = KINDS[kind]
    return wb.fit(thing(name), margin=MARGIN, device="cpu", progress=False, **told)


def others(name: str):
    """Shapes that are another thing each, but of the same geometry."""
    own = thing(name)
    yield "another margin", own.dilated(2 * MARGIN)
    yield "less margin", own.dilated(MARGIN / 2)
    yield "the other side", wb.shapes.Complement(own)
    yield "the other side of the dilated one", wb.shapes.Complement(own.dilated(MARGIN))
    if name == "motion":
        yield "fewer times", wb.shapes.MovingMesh(FRAMES[:2], BOX.faces, times=[0.0, 1.0])
        yield "other times", wb.shapes.MovingMesh(FRAMES, BOX.faces, times=[0.5, 1.0, 2.0])
        yield "no time", thing("mesh")
    else:
        yield "a time", thing("motion")
    if name not in ("motion", "grid"):
        yield "cells of another fineness", own.to_grid(resolution=12, margin=2 * MARGIN)


@pytest.mark.parametrize("kind", KINDS)
def test_another_shape_is_never_proven(kind):
    """Refused before a proof, by ``certify``, ``prove`` and ``settle`` alike; the shape that is meant is proven."""
    bounder, name = of_kind(kind), KINDS[kind][0]
    assert mismatch(bounder, as_fitted(bounder, thing(name))) is None
    for given in (thing(name), thing(name).dilated(MARGIN)):
        assert wb.certify(bounder, given, margin=MARGIN).proven
    for what, other in others(name):
        assert mismatch(bounder, other), what
        found = wb.certify(bounder, other)
        assert found.kind == "inapplicable", (what, found)
        assert found.message, what
        if kind != "distance":
            for step, told in ((prove, ()), (settle, (None,))):
                with pytest.raises(BounderError):
                    step(bounder.to("cpu"), other, *told)


def told(document, **values):
    """Say it in the file and in the certificate alike."""
    for part in (document, document["certificate"]):
        part.update({name: value for name, value in values.items() if name in part})


def widened(document, name, by):
    """Move one of the domain's numbers, the certificate's corners with it."""
    domain = document["domain"]
    domain[name] = [a + b for a, b in zip(domain[name], by, strict=True)]
    document["certificate"]["domain"] = [domain["lower"], domain["upper"]]


# Everything in a file's JSON that no tensor tells, and that a proof could be misled by.
LIES = {
    "a larger margin": lambda d: told(d, margin=4 * MARGIN),
    "no margin": lambda d: told(d, margin=0.0),
    "a resolution": lambda d: told(d, resolution=16),
    "another method": lambda d: d.update(method="obb" if d["method"] == "aabb" else "aabb"),
    "another query": lambda d: (told(d, query="box"), d["domain"].update(query="box")),
    "the other side": lambda d: d["domain"].update(unbounded=True),
    "time": lambda d: (d.update(motion="time"), d["domain"].update(time=True, moving=True, speed=1.0)),
    "no time": lambda d: (d.update(motion=None), d["domain"].update(time=False, moving=False)),
    "a smaller domain": lambda d: widened(d, "lower", [0.25] * len(d["domain"]["lower"])),
    "a larger domain": lambda d: widened(d, "upper", [4.0] * len(d["domain"]["lower"])),
    "a wider limit": lambda d: d["domain"].update(limit=[1.75] * len(d["domain"]["limit"])),
    "another centre": lambda d: d["domain"].update(center=[c + 0.25 for c in d["domain"]["center"]]),
    "a coarser scale": lambda d: d["domain"].update(scale=[s / 4 for s in d["domain"]["scale"]]),
    "no delta": lambda d: d["domain"].update(delta=[0.0] * len(d["domain"]["lower"])),
    "a higher threshold": lambda d: told(d, threshold=d["threshold"] + 0.25, lower_bound=9.0),
    "longer rays": lambda d: (told(d, length=2.0), d["domain"].update(length=2.0)),
}


@pytest.mark.parametrize("lie", LIES)
@pytest.mark.parametrize("kind", KINDS)
def test_a_file_that_lies_is_found_out(kind, lie, tmp_path, rng):
    """It does not load, or is not proven, or is true all the same: then it misses nothing of what it claims."""
    bounder, own = of_kind(kind), thing(KINDS[kind][0])
    try:
        invalid = wb.load(edited(bounder, tmp_path / "b.safetensors", LIES[lie]), device="cpu")
    except FileFormatError:
        return
    proof = wb.certify(invalid, own, budget=5.0)
    if not proof.proven:
        return
    assert wb.certify(invalid, own, margin=MARGIN).proven == (proof.margin == MARGIN)
    claimed = as_fitted(invalid, own)
    assert (proof.margin, proof.query) == (claimed.margin, invalid.query_kind)
    if invalid.query_kind in ("point", "distance"):
        x = (claimed.lower + rng.random((4000, claimed.ndim)) * (claimed.upper - claimed.lower)).astype(np.float32)
        x = x[claimed.decide(x) == IN]
        assert len(x)
        assert invalid.query(x).numpy().all()


def test_two_sides_are_of_one_object():
    """Objects are compared, and an inner margin above the outer one says nothing of any object."""
    flat = {"ball": ball_at([0, 0], 1.0), "box": box_of([-2, -2], [2, 2])}
    told = {"side": "inside", "hidden": (8,), "steps": 20, "budget": 20.0, "device": "cpu", "progress": False}
    which = (("ball", 0.0), ("ball", 0.25), ("box", 0.0))
    inner = {(name, margin): wb.fit(flat[name], margin=margin, **told) for name, margin in which}
    for name, margin, resolution in (("ball", 0.0, None), ("ball", 0.25, 16), ("ball", 0.5, None), ("box", 0.25, 16)):
        told = {"margin": margin, "resolution": resolution, "device": "cpu", "progress": False}
        outer = wb.fit(flat[name], method="aabb", **told)
        for (object_, within), half in inner.items():
            if name == object_ and margin >= within:
                assert wb.two_sided(outer, half).outer is outer
                continue
            with pytest.raises(BounderError, match=r"same object|outer margin") as found:
                wb.two_sided(outer, half)
            assert "\n" not in str(found.value)
    unknown = wb.fit(flat["ball"], method="aabb", device="cpu", progress=False)
    unknown.info = {}
    unknown.freeze(unknown.threshold, None)
    with pytest.raises(BounderError, match="not known"):
        wb.two_sided(unknown, inner["ball", 0.0])


def test_parts_keep_the_checks_of_the_whole(monkeypatch):
    """``certify`` asks of every part what ``prove`` asks: here one is of the other side, and of another margin."""
    bounder = of_kind("cascade")
    for change in ({"domain": dataclasses.replace(bounder.domain, unbounded=True)}, {"info": {"margin": 2 * MARGIN}}):
        parts = bounder.parts
        for name, value in change.items():
            setattr(parts[0], name, value)
        with monkeypatch.context() as patched:
            patched.setattr(type(bounder), "parts", property(lambda _, parts=parts: parts))
            assert not wb.certify(bounder, thing("mesh")).proven


def test_files_of_older_digests_stay_true(tmp_path):
    """Their digest left the margin out: they load, are proven, and are put together with newer ones."""

    def aged(document):
        told(document, indicator=thing("mesh").geometry)
        document.pop("shape")

    old = wb.load(edited(of_kind("points"), tmp_path / "old.safetensors", aged), device="cpu")
    for name in ("indicator", "shape"):
        assert old.info[name] == of_kind("points").info[name]
    assert (
        old.certificate.indicator == of_kind("points").certificate.indicator == wb.certify(old, thing("mesh")).indicator
    )
    assert wb.certify(old, thing("mesh"), margin=MARGIN).proven
    sphere = wb.fit(thing("mesh"), method="sphere", margin=MARGIN, device="cpu", progress=False)
    assert wb.cascade(sphere, old).certificate.proven
    with pytest.raises(BoundingError, match="expected bounders of the same"):
        wb.cascade(wb.fit(thing("mesh"), method="sphere", device="cpu", progress=False), old)
