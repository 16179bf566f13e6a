"""Files of region bounders: they come back as they were, and one that contradicts itself is refused."""

from functools import cache

import numpy as np
import pytest
import safetensors.numpy
from bounding_shapes import shape, told_of
from region_cases import REGIONS, hard_regions
from rewriting import check_refused, rewrite

import warp_bounding as wb
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.errors import BounderError
from warp_bounding.proof import attest, prove
from warp_bounding.queries.region_domain import domain_of

LENGTH = 0.75
CLASSICS = (("aabb", "animated"), ("sphere", "c"))


@cache
def classic(method: str, query: str, name: str):
    told = told_of(method, query, length=LENGTH, steps=3)
    return wb.fit(shape(name), query=query, method=method, device="cpu", **told)


@cache
def network(query: str, name: str) -> Mlp:
    """Random weights and an honest certificate."""
    grid, rng = shape(name), np.random.default_rng(3)
    domain, tensors = domain_of(grid, query, LENGTH), {}
    n, outputs = grid.ndim, 2 if query == "plane" else 1
    inputs = n if query == "plane" else domain.ndim
    for index, (k, h) in enumerate(((inputs, 6), (6, outputs))):
        tensors[f"layers.{index}.weight"] = rng.normal(size=(h, k)).astype(np.float32)
        tensors[f"layers.{index}.bias"] = rng.normal(size=h).astype(np.float32)
    sizes = {"hidden": [6], "activation": "sin", "octaves": 0}
    bounder = Mlp(domain, tensors, sizes, "cpu")
    if query == "plane":
        prove(bounder, grid, eps=0.1)
    else:
        attest(bounder, grid, least=-6.0, room=0.0, count=10_000)
    bounder.info = {"indicator": grid.digest, "margin": 0.0, "seed": 0}
    return bounder


def check_round_trip(bounder, path, rng) -> None:
    bounder.save(path)
    twin, query = wb.load(path, device="cpu"), bounder.query_kind
    q = hard_regions(query, shape("animated" if bounder.domain.time else "c"), rng, LENGTH, 1000)
    assert type(twin) is type(bounder)
    assert twin.certificate == bounder.certificate
    assert (twin.query_kind, twin.domain.length) == (query, bounder.domain.length)
    assert twin.domain.to_dict() == bounder.domain.to_dict()
    assert twin.data.parameters.numpy().tobytes() == bounder.data.parameters.numpy().tobytes()
    assert (twin.query(q).numpy() == bounder.query(q).numpy()).all()
    twin.info.pop("library")
    twin.save(path)  # with the digests that ``load`` has brought up
    before = path.read_bytes()
    wb.load(path, device="cpu").save(path)
    assert path.read_bytes() == before


@pytest.mark.parametrize("query", REGIONS)
@pytest.mark.parametrize(("method", "name"), CLASSICS)
def test_classics_come_back(method, query, name, tmp_path, rng):
    bounder = classic(method, query, name)
    assert bounder.certificate.proven
    check_round_trip(bounder, tmp_path / "b.safetensors", rng)


@pytest.mark.parametrize("name", ["c", "animated"])
@pytest.mark.parametrize("query", REGIONS)
def test_networks_come_back(query, name, tmp_path, rng):
    bounder = network(query, name)
    assert bounder.certificate.kind == ("proven" if query == "plane" else "statistical")
    check_round_trip(bounder, tmp_path / "b.safetensors", rng)


def test_volumes_around_numbers_of_queries_are_gone(tmp_path):
    path = tmp_path / "b.safetensors"
    classic("aabb", "ray", "c").save(path)
    rewrite(path, both(space="parametric"))
    check_refused(path, "volumes in parametric space are gone: fit one around the object")


def test_files_that_speak_of_moments(tmp_path):
    """Older files say that there are none; a network that was given a ray's moments is refused."""
    path, bounder = tmp_path / "b.safetensors", network("ray", "c")
    bounder.save(path)
    rewrite(path, lambda d: d["sizes"].update(moments=False))
    twin = wb.load(path, device="cpu")
    assert twin.data.parameters.numpy().tobytes() == bounder.data.parameters.numpy().tobytes()
    for other in (True, "yes"):
        rewrite(path, lambda d, other=other: d["sizes"].update(moments=other))
        check_refused(path, "moments")


def domain_edit(**fields):
    return lambda d: d["domain"].update(fields)


def both(**fields):
    """In the description and in the domain inside it, as one would who knows the format."""

    def change(document):
        document.update(fields)
        document["domain"].update(fields)

    return change


EDITS = {
    "length outside": lambda d: d.update(length=0.5),
    "length inside": domain_edit(length=0.5),
    "length none": both(length=None),
    "length zero": both(length=0.0),
    "length negative": both(length=-1.0),
    "length nan": both(length=float("nan")),
    "length infinite": both(length=float("inf")),
    "length text": both(length="long"),
    "length beyond delta": both(length=1e6),
    "query outside": lambda d: d.update(query="box"),
    "query inside": domain_edit(query="box"),
    "query point": domain_edit(query="point"),
    "query unknown": both(query="cone"),
    "query without length": both(query="box", length=None),
    "space outside": lambda d: d.update(space="parametric"),
    "space inside": domain_edit(space="parametric"),
    "space unknown": both(space="flat"),
    "space list": both(space=["geometric"]),
    "motion outside": lambda d: d.update(motion="time"),
    "motion inside": domain_edit(moving=True),
    "time of the base": domain_edit(time=True),
    "delta": domain_edit(delta=[1e-9, 1e-9]),
    "limit": domain_edit(limit=[0.9, 0.9]),
    "scale": lambda d: d["domain"].update(scale=[2 * s for s in d["domain"]["scale"]]),
    "no query": lambda d: d["domain"].pop("query"),
    "no space": lambda d: d["domain"].pop("space"),
    "no length": lambda d: d["domain"].pop("length"),
    "claim's query": lambda d: d["certificate"].update(query="point"),
    "claim's threshold": lambda d: d["certificate"].update(threshold=-20.0),
    "claim's domain": lambda d: d["certificate"].update(domain=[[0.0, 0.0], [1.0, 1.0]]),
    "threshold": lambda d: d.update(threshold=0.5),
    "method": lambda d: d.update(method="mlp" if d["method"] == "aabb" else "aabb"),
}


@pytest.mark.parametrize("edit", EDITS)
@pytest.mark.parametrize("kind", ["aabb", "mlp"])
def test_edits_that_do_not_add_up_are_refused(kind, edit, tmp_path):
    path = tmp_path / "b.safetensors"
    (network("ray", "c") if kind == "mlp" else classic("aabb", "ray", "c")).save(path)
    rewrite(path, EDITS[edit])
    check_refused(path)


def test_a_whole_lie_is_found_by_certify(tmp_path):
    """A network of boxes has as many inputs as one of rays."""
    path = tmp_path / "b.safetensors"
    network("ray", "c").save(path)

    def lie(document):
        both(query="box", length=None)(document)
        document["certificate"].update(query="box", length=None, lower_bound=1.0)
        document["threshold"] = document["certificate"]["threshold"] = 0.5

    rewrite(path, lie)
    liar = wb.load(path, device="cpu")
    assert liar.query_kind == "box"
    assert wb.certify(liar, shape("c")).kind == "refuted"


def test_a_network_cannot_claim_a_proof_that_nobody_has(tmp_path, monkeypatch):
    monkeypatch.setattr(Mlp, "provable", False)
    path, bounder = tmp_path / "b.safetensors", network("ray", "c")
    bounder.save(path)
    rewrite(path, lambda d: d["certificate"].update(kind="proven", lower_bound=1e6))
    check_refused(path, "claims a proof")
    with pytest.raises(BounderError, match="no proof"):
        prove(bounder, shape("c"))


def test_what_is_not_conservative_cannot_claim_anything(tmp_path):
    path = tmp_path / "b.safetensors"
    network("ray", "c").save(path)
    rewrite(path, lambda d: d.update(method="occupancy"))
    check_refused(path, "not conservative")


@pytest.mark.parametrize("query", REGIONS)
def test_wrong_tensors_are_refused(query, tmp_path):
    path = tmp_path / "b.safetensors"
    network(query, "c").save(path)
    tensors = {name: value.copy() for name, value in safetensors.numpy.load_file(path).items()}
    wide = np.zeros((6, tensors["layers.0.weight"].shape[1] + 1), np.float32)
    rewrite(path, lambda d: None, tensors | {"layers.0.weight": wide})
    check_refused(path)


def test_a_plane_has_two_outputs(tmp_path):
    path = tmp_path / "b.safetensors"
    network("plane", "c").save(path)
    tensors = {name: value.copy() for name, value in safetensors.numpy.load_file(path).items()}
    one = {name: tensors[name][:1] for name in ("layers.1.weight", "layers.1.bias")}
    rewrite(path, lambda d: None, tensors | one)
    check_refused(path, "expected tensors")


def test_every_flipped_byte_is_noticed(tmp_path, rng):
    path = tmp_path / "b.safetensors"
    network("box", "c").save(path)
    content = bytearray(path.read_bytes())
    for position in rng.permutation(len(content))[:400]:
        old = content[position]
        content[position] = (old + int(rng.integers(1, 256))) % 256
        path.write_bytes(content)
        check_refused(path)
        content[position] = old
