"""What says one thing and is asked about another is never proven: every kind of bounder, against shapes that are not
what it claims, and files that lie."""

import dataclasses
import json
from functools import cache

import numpy as np
import pytest
import trimesh

import warp_bounding as wb
from warp_bounding.bounders import file_format
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.bounders.union import Union
from warp_bounding.certificates.claim import as_fitted, mismatch
from warp_bounding.errors import BounderError, BoundingError, FileFormatError
from warp_bounding.indicators.shape import IN
from warp_bounding.proof import prove, settle
from warp_bounding.queries.domain import Domain

BOX = trimesh.creation.box(extents=(1.0, 1.2, 0.8))
MARGIN = 0.125
FRAMES = np.stack([BOX.vertices, BOX.vertices + np.array([0.25, 0, 0]), BOX.vertices]).astype(np.float32)
CUBES = np.zeros((6, 6, 6), bool)
CUBES[1:4, 2:4, 1:5] = True


@cache
def shape(name: str):
    """A mesh, its cells, a motion, a solid, and a function whose distance is too short."""
    if name == "motion":
        return wb.IndicatorMotion(FRAMES, BOX.faces, times=[0.0, 1.0, 2.0], time_cells=4)
    if name == "grid":
        return wb.IndicatorGrid(CUBES)
    if name == "solid":
        return wb.solids.Box([-0.5, -0.6, -0.4], [0.5, 0.6, 0.4])
    if name == "function":
        return wb.IndicatorFunction(
            None, [-1, -1, -1], [1, 1, 1], distance=lambda x: 0.5 * (np.linalg.norm(x, axis=1) - 1)
        )
    return wb.IndicatorMesh(BOX.vertices, BOX.faces)


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
def fitted(kind: str):
    """Proven, with a margin; never change it."""
    name, told = KINDS[kind]
    return wb.fit(shape(name), margin=MARGIN, device="cpu", progress=False, **told)


def others(name: str):
    """Shapes that are another thing each, but of the same geometry."""
    own = shape(name)
    yield "another margin", own.dilated(2 * MARGIN)
    yield "less margin", own.dilated(MARGIN / 2)
    yield "the other side", wb.Complement(own)
    yield "the other side of the dilated one", wb.Complement(own.dilated(MARGIN))
    if name == "motion":
        yield "fewer times", wb.IndicatorMotion(FRAMES[:2], BOX.faces, times=[0.0, 1.0])
        yield "other times", wb.IndicatorMotion(FRAMES, BOX.faces, times=[0.5, 1.0, 2.0])
        yield "no time", shape("mesh")
    else:
        yield "a time", shape("motion")
    if name not in ("motion", "grid"):
        yield "cells of another fineness", own.to_grid(resolution=12, margin=2 * MARGIN)


@pytest.mark.parametrize("kind", KINDS)
def test_another_shape_is_never_proven(kind):
    """Whatever is given is refused before a proof, with the reason; the shape that is meant is proven, dilated by
    ``certify`` or before."""
    bounder, name = fitted(kind), KINDS[kind][0]
    for given in (shape(name), shape(name).dilated(MARGIN)):
        assert wb.certify(bounder, given, margin=MARGIN).proven
    for what, other in others(name):
        found = wb.certify(bounder, other)
        assert found.kind == "inapplicable", (what, found)
        assert found.message, what


@pytest.mark.parametrize("kind", KINDS)
def test_no_threshold_is_set_by_a_proof_of_another_shape(kind):
    """``prove`` and ``settle`` refuse what ``certify`` does, by the same function."""
    bounder, name = fitted(kind), KINDS[kind][0]
    assert mismatch(bounder, as_fitted(bounder, shape(name))) is None
    for what, other in others(name):
        assert mismatch(bounder, other), what
        for step in (prove, settle):
            if kind != "distance":
                with pytest.raises(BounderError):
                    step(bounder.to("cpu"), other, *([] if step is prove else [None]))


def lying(bounder, path, change):
    """A bounder whose file was changed, its digest made right again."""
    bounder.save(path)
    tensors, entry = file_format._read(path)
    document = json.loads(entry)["bounder"]
    change(document)
    entry = json.dumps({"sha256": file_format.digest_of(tensors, document), "bounder": document})
    path.write_bytes(file_format.safetensors.numpy.save(tensors, metadata={file_format.KEY: entry}))
    return wb.load(path, device="cpu")


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
    "another metric": lambda d: d["sizes"].update(metric="spacetime"),
    "pieces": lambda d: d.update(pieces={"whole": "0" * 64, "count": 3, "held": [1]}),
}


@pytest.mark.parametrize("lie", LIES)
@pytest.mark.parametrize("kind", KINDS)
def test_a_file_that_lies_is_found_out(kind, lie, tmp_path, rng):
    """It does not load; or it is not proven; or what it says is true all the same: then it misses nothing of the object
    that it claims."""
    bounder, own = fitted(kind), shape(KINDS[kind][0])
    try:
        liar = lying(bounder, tmp_path / "b.safetensors", LIES[lie])
    except FileFormatError:
        return
    proof = wb.certify(liar, own, seconds=20.0)
    if not proof.proven:
        return
    assert wb.certify(liar, own, margin=MARGIN).proven == (proof.margin == MARGIN)
    claimed = as_fitted(liar, own)
    assert (proof.margin, proof.query) == (claimed.margin, liar.query_kind)
    if liar.query_kind in ("point", "distance"):
        x = (claimed.lower + rng.random((4000, claimed.ndim)) * (claimed.upper - claimed.lower)).astype(np.float32)
        x = x[claimed.decide(x) == IN]
        assert len(x)
        assert liar.query(x).numpy().all()


def test_a_checkpoint_is_of_one_claim(tmp_path):
    """Of another margin, threshold, method's numbers, shape, or of a function whose object is the same and whose
    distance is not."""

    def ball(steep):
        return wb.IndicatorFunction(
            None,
            [-1, -1],
            [1, 1],
            distance=lambda x: np.linalg.norm(x, axis=1) - 1 - steep * (np.linalg.norm(x, axis=1) > 1.5),
            lipschitz=3.0,
        )

    def claim(margin):
        again = far.to()
        again.info = far.info | {"margin": margin, "rates": None, "shape": None}
        return again

    far = wb.fit(ball(0.0), "distance", "distance-grid", nodes=9, budget=3.0, device="cpu", progress=False)
    file = tmp_path / "left"
    wb.certify(far, ball(0.0), seconds=0.0, checkpoint=file)
    content = file.read_bytes()
    for bounder, other in (
        (claim(0.01), ball(0.0)),
        (far, ball(0.25)),
        (far, wb.IndicatorFunction(None, [-1, -1], [1, 1], distance=lambda x: np.abs(x).max(axis=1) - 1)),
        (far.to().freeze(far.threshold - 1.0, None), ball(0.0)),
    ):
        bounder.info = far.info | bounder.info
        with pytest.raises(FileFormatError, match="another bounder, shape or version"):
            wb.certify(bounder, other, checkpoint=file)
        assert file.read_bytes() == content
    assert wb.certify(far, ball(0.0), checkpoint=file).kind in ("proven", "undecided")


def test_two_sides_are_of_one_object():
    """Whatever their margins and cells: objects are compared, and an inner margin above the outer one says nothing of
    any object."""
    flat = {"ball": wb.solids.Sphere([0, 0], 1.0), "box": wb.solids.Box([-2, -2], [2, 2])}
    inner = {
        (name, margin): wb.fit(
            own, side="inside", hidden=(8,), steps=20, budget=20.0, margin=margin, device="cpu", progress=False
        )
        for name, own in flat.items()
        for margin in (0.0, 0.25)
        if (name, margin) != ("box", 0.25)
    }
    for name, own in flat.items():
        for margin in (0.0, 0.25, 0.5):
            for resolution in (None, 16):
                outer = wb.fit(own, method="aabb", margin=margin, resolution=resolution, device="cpu", progress=False)
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
    """``certify`` asks of every part what ``prove`` asks of it: here a part is about the other side, and about another
    margin."""
    bounder = fitted("cascade")
    for change in (
        {"domain": dataclasses.replace(bounder.domain, unbounded=True)},
        {"info": {"margin": 2 * MARGIN}},
    ):
        parts = bounder.parts
        for name, value in change.items():
            setattr(parts[0], name, value)
        with monkeypatch.context() as patched:
            patched.setattr(type(bounder), "parts", property(lambda _, parts=parts: parts))
            assert not wb.certify(bounder, shape("mesh")).proven


def test_files_of_older_digests_stay_true(tmp_path):
    """Their digest left the margin out: they load, are proven, and are put together with newer ones."""

    def aged(document):
        told(document, indicator=shape("mesh").geometry)
        document.pop("shape")

    old = lying(fitted("points"), tmp_path / "old.safetensors", aged)
    for name in ("indicator", "shape"):
        assert old.info[name] == fitted("points").info[name]
    assert (
        old.certificate.indicator == fitted("points").certificate.indicator == wb.certify(old, shape("mesh")).indicator
    )
    assert wb.certify(old, shape("mesh"), margin=MARGIN).proven
    sphere = wb.fit(shape("mesh"), method="sphere", margin=MARGIN, device="cpu", progress=False)
    assert wb.cascade(sphere, old).certificate.proven
    with pytest.raises(BoundingError, match="expected bounders of the same"):
        wb.cascade(wb.fit(shape("mesh"), method="sphere", device="cpu", progress=False), old)


def test_parts_in_boxes_do_not_hold_what_has_no_end(tmp_path):
    """A union from the inside whose part denies nearly everything outside of its box is no proof about that."""
    ball, big = wb.solids.Sphere([0, 0], 1.0), wb.solids.Sphere([0, 0], 5.0)
    domain = Domain.of(wb.Complement(big))
    reach = float(domain.scale[0]) * 2
    tensors = {
        "layers.0.weight": np.float32([[1, 0], [-1, 0]]),
        "layers.0.bias": np.float32([-reach, -reach]),
        "layers.1.weight": np.float32([[-50, -50]]),
        "layers.1.bias": np.float32([1]),
    }
    part = Mlp(domain, tensors, {"hidden": [2], "activation": "relu"}, "cpu").freeze(0.5, None)
    for region in ((np.full(2, -1.5), np.full(2, 1.5)), (np.full(2, -1e3), np.full(2, 1e3)), None):
        whole = Union.of([part], [region]).freeze(0.0, None)
        whole.info = {"margin": 0.0, "resolution": None}
        whole.save(tmp_path / "u.safetensors")
        assert not wb.certify(tmp_path / "u.safetensors", ball).proven
