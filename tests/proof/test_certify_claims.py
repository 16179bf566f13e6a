"""What a certificate is about: the object, its margin, the length of rays, the resolution; and a claim that is not the expected one."""

import json
import re

import numpy as np
import pytest
import trimesh
from bounding_shapes import shape

import warp_bounding as wb
from warp_bounding.bounders import file_format
from warp_bounding.certificates.certificate import ABOUT
from warp_bounding.certificates.statement import statement
from warp_bounding.errors import FileFormatError, QueryError
from warp_bounding.queries.domain import rounding_of_map
from warp_bounding.queries.placement import Placement, placement_error

MESH = wb.IndicatorMesh(*(lambda m: (m.vertices, m.faces))(trimesh.creation.box(extents=(1, 1, 2))), name="brick.obj")


def bounder_of(query="point", margin=0.1, length=0.75, resolution=8, **options):
    options = {"query": query, "margin": margin, "resolution": resolution} | options
    options |= {"length": length} if query == "ray" else {}
    return wb.fit(MESH, method="aabb", device="cpu", **options)


def edited(path, change):
    """Change the description in a file, its digest made right again."""
    tensors, entry = file_format._read(path)
    document = json.loads(entry)["bounder"]
    change(document)
    entry = json.dumps({"sha256": file_format.digest_of(tensors, document), "bounder": document})
    path.write_bytes(file_format.safetensors.numpy.save(tensors, metadata={file_format.KEY: entry}))
    return path


@pytest.mark.parametrize("query", ["point", "ray", "plane", "box"])
def test_certificates_say_what_they_are_about(query):
    bounder = bounder_of(query)
    for certificate in (bounder.certificate, wb.certify(bounder, MESH)):
        assert certificate.proven
        about = (certificate.object, certificate.margin, certificate.length, certificate.resolution)
        assert about == ("brick.obj", 0.1, 0.75 if query == "ray" else None, 8)
        assert len(certificate.placement) == 3
        for words in ("brick.obj", "dilated by 0.1", "resolution 8", "xform= or scale=", "rounds a query by more than"):
            assert words in certificate.message
        assert ("length 0.75" in certificate.message) == (query == "ray")
        assert type(certificate).from_dict(json.loads(json.dumps(certificate.to_dict()))) == certificate
    said = " ".join(statement(bounder).values())
    for words in ("brick.obj", "dilated by 0.1", "at resolution 8", "xform= and scale= may round a query by up to"):
        assert words in said
    assert ("t <= 0.75" in said) == (query == "ray")


def test_a_statistical_certificate_says_so_too():
    options = {"hidden": (8,), "steps": 3, "length": 0.5, "device": "cpu", "seed": 1}
    bounder = wb.fit(shape("c"), query="ray", method="mlp", budget=1.0, **options)
    assert bounder.certificate.length == 0.5
    assert "length 0.5" in bounder.certificate.message
    assert bounder.certificate.object == "array"


EXPECTED = [
    ("point", {"margin": 0.2}, ("margin 0.2", "margin 0.1")),
    ("point", {"margin": 0.0}, ("margin 0.0", "margin 0.1")),
    ("ray", {"length": 2.0}, ("length 2.0", "length 0.75")),
    ("point", {"length": 1.0}, ("length 1.0", "length none")),
    ("box", {"resolution": 64}, ("resolution 64", "resolution 8")),
    ("box", {"query": "ray"}, ("query ray", "query box")),
    ("ray", {"margin": 0.1, "length": 0.75000001}, ("length 0.75000001", "length 0.75")),
]


@pytest.mark.parametrize(("query", "expected", "words"), EXPECTED)
def test_another_claim_than_the_expected_one_is_not_proven(query, expected, words):
    bounder = bounder_of(query)
    proof = wb.certify(bounder, MESH, **expected)
    assert proof.kind == "inapplicable"
    assert proof.indicator == bounder.info["indicator"]
    for word in words:
        assert word in proof.message
    own = {"query": query, "margin": 0.1, "resolution": 8} | ({"length": 0.75} if query == "ray" else {})
    assert wb.certify(bounder, MESH, **own).proven


@pytest.mark.parametrize("value", [np.nan, -1.0, np.inf])
def test_an_impossible_expectation_is_never_met(value):
    assert wb.certify(bounder_of(), MESH, margin=value).kind == "inapplicable"


def test_a_claim_edited_in_a_file_is_told_or_found_out(tmp_path):
    """Margin and length beside the certificate contradict it; edited in both, they are another claim, which is named."""
    path = tmp_path / "b.safetensors"
    for query, change in (
        ("point", lambda d: d.update(margin=0.05)),
        ("point", lambda d: d.update(resolution=4)),
        ("point", lambda d: d.update(name="cube.obj")),
        ("ray", lambda d: (d.update(length=0.5), d["domain"].update(length=0.5))),
        ("ray", lambda d: d["certificate"].update(length=0.5)),
        ("point", lambda d: d["certificate"].update(margin=None)),
        ("point", lambda d: d["certificate"].update(placement=[1.0] * 3)),
        ("point", lambda d: d["certificate"].update(placement=[0.0])),
        ("point", lambda d: d["certificate"].update(placement="far")),
    ):
        bounder_of(query).save(path)
        with pytest.raises(FileFormatError, match="does not add up"):
            wb.load(edited(path, change), device="cpu")

    def smaller(document):
        for part in (document, document["certificate"], document["domain"]):
            part["length"] = 0.5

    bounder_of("ray").save(path)
    lie = wb.load(edited(path, smaller), device="cpu")
    proof = wb.certify(lie, MESH)
    assert proof.proven
    assert proof.length == 0.5
    assert "length 0.5" in proof.message
    assert not wb.certify(lie, MESH, length=0.75).proven


def test_files_of_older_versions_load_and_certify(tmp_path):
    """They hold none of what a certificate is about; it stands beside it."""
    path = tmp_path / "b.safetensors"
    bounder_of("ray").save(path)
    old = wb.load(edited(path, lambda d: [d["certificate"].pop(name) for name in ABOUT]), device="cpu")
    assert [getattr(old.certificate, name) for name in ABOUT] == [None] * len(ABOUT)
    assert "dilated by 0.1" in statement(old)["object"]
    assert "xform= and scale= may round a query by up to" in statement(old)["placement"]
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


def test_an_expected_number_is_compared_exactly():
    bounder = bounder_of(margin=0.1)
    assert wb.certify(bounder, MESH, margin=np.float64(0.1), resolution=np.int64(8)).proven
    certificate = wb.certify(bounder, MESH, margin=np.float32(0.1))  # which is a little more
    assert certificate.kind == "inapplicable"
    assert "expected margin 0.10000000149011612, the bounder is for margin 0.1" in certificate.message


@pytest.mark.parametrize("expected", [{"margin": "0.1"}, {"length": [0.75]}, {"resolution": True}])
def test_what_is_expected_must_be_a_number(expected):
    with pytest.raises(wb.BoundingError, match=f"^{next(iter(expected))} must be a number, got"):
        wb.certify(bounder_of(), MESH, **expected)


def test_what_is_said_of_a_domain_and_of_rounding_is_readable():
    """Corners to the digits that a side has, without denormals and negative zeros; rounding in object units, not in shares of a detail."""
    vertices = MESH.vertices.astype(np.float64) - MESH.vertices.min(axis=0) + [0.25, 0.25, 1234.75]
    mesh = wb.IndicatorMesh(vertices, MESH.faces, name="far.obj")
    bounder = wb.fit(mesh, method="aabb", margin=0.25, device="cpu")
    assert 0 > bounder.domain.lower[0] > -1e-9
    said = statement(bounder)
    lower, upper = re.search(r"\((.*?)\) to \((.*?)\)", said["for"]).groups()
    assert lower.split(", ")[:2] == ["0", "0"]
    for corner, told in ((bounder.domain.lower, lower), (bounder.domain.upper, upper)):
        assert np.abs(np.array([float(word) for word in told.split(",")]) - corner).max() < 1e-2
    covered = bounder.domain.delta / bounder.domain.scale
    assert f"up to {covered.max():.2g} (object units) on each axis" in said["input error"]
    assert not re.search(r"e-[34]\d", " ".join(said.values()))
    in_cells = wb.fit(mesh, method="bvh", resolution=8, margin=0.25, device="cpu")
    assert not re.search(r"e-[34]\d", " ".join([*statement(in_cells).values(), in_cells.certificate.message]))


@pytest.mark.parametrize("query", ["point", "ray"])
def test_input_error_of_a_motion_tells_time_apart(query):
    frames = np.stack([MESH.vertices, MESH.vertices + np.float32(0.5)])
    motion = wb.IndicatorMotion(frames, MESH.faces, times=[0.0, 100.0], time_cells=4)
    bounder = wb.fit(motion, query, "aabb", resolution=8, device="cpu")
    covered = bounder.domain.base.delta / bounder.domain.base.scale
    assert (
        f"{covered[1:].max():.2g} (object units) on each axis and {covered[0]:.2g} in time"
        in statement(bounder)["input error"]
    )
