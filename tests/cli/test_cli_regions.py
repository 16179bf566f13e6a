"""The command line over rays, planes and boxes: what is proven and what is not shows in status, text and JSON."""

import json

import numpy as np
import pytest
from bounding_shapes import shape, without_proof
from commands import check_bad, run
from PIL import Image

from warp_bounding.proof import attest

KINDS = dict.fromkeys(("ray", "plane", "box"), "proven")
FIT = ("--steps", 30, "--hidden", 8, "--samples", 20_000)


@pytest.fixture(scope="module")
def picture(tmp_path_factory):
    """A tiny image whose alpha channel is the object."""
    alpha = np.where(shape("c").occupancy, 255, 0).astype(np.uint8)
    rgba = np.dstack([np.full_like(alpha, 90)] * 3 + [alpha])
    path = tmp_path_factory.mktemp("shapes") / "c.png"
    Image.fromarray(rgba).save(path)
    return path


@pytest.fixture(scope="module")
def fits(picture):
    """Where the fitted networks are, one a kind of query."""
    return {query: picture.parent / f"{query}.safetensors" for query in KINDS}


@pytest.fixture
def fitted(request, picture, fits, capsys):
    query = request.param
    if not fits[query].exists():
        length = ("--length", 0.75) if query == "ray" else ()
        status, out, _ = run(capsys, "fit", picture, "-o", fits[query], "--query", query, *FIT, *length, "--json")
        assert status == 0
        assert len(out.strip().splitlines()) == 1
        fits[query].with_suffix(".json").write_text(out)
    return query, fits[query], json.loads(fits[query].with_suffix(".json").read_text())


each = pytest.mark.parametrize("fitted", KINDS, indirect=True)


@each
def test_fit(fitted):
    query, path, result = fitted
    assert (result["query"], result["method"], result["conservative"], result["fn"]) == (query, "mlp", True, 0)
    assert (result["samples"], result["path"]) == (20_000, str(path))
    certificate = result["certificate"]
    assert (certificate["kind"], certificate["query"]) == (KINDS[query], query)
    assert 0 < result["fp_rate"] < 100


@each
def test_evaluate_by_both_protocols(fitted, picture, capsys):
    _, path, result = fitted
    rates = {}
    for protocol in ("exact", "sampled"):
        options = ("--samples", 20_000, "--protocol", protocol, "--json")
        status, out, _ = run(capsys, "evaluate", path, picture, *options)
        rates[protocol] = json.loads(out)
        assert status == 0
        assert (rates[protocol]["protocol"], rates[protocol]["fn"]) == (protocol, 0)
    assert rates["exact"]["fp_rate"] == result["fp_rate"]
    assert rates["exact"]["positives"] >= rates["sampled"]["positives"] > 0
    assert rates["exact"]["fp_rate"] <= rates["sampled"]["fp_rate"]
    status, out, _ = run(capsys, "evaluate", path, picture, "--samples", 5000)
    assert status == 0
    assert "0 false negatives" in out


@each
def test_certify(fitted, picture, capsys):
    query, path, _ = fitted
    status, out, _ = run(capsys, "certify", path, picture, "--json")
    result = json.loads(out)
    assert status == (0 if KINDS[query] == "proven" else 1)
    assert result["proven"] == (KINDS[query] == "proven")
    assert result["certificate"]["kind"] == KINDS[query]
    assert result["same_indicator"] is True
    status, out, _ = run(capsys, "certify", path, picture)
    assert status == (0 if KINDS[query] == "proven" else 1)
    assert out.startswith(KINDS[query])
    assert ("not proven" in out) == (KINDS[query] != "proven")


@each
def test_certify_another_shape(fitted, picture, capsys):
    query, path, _ = fitted
    other = picture.parent / "other.npy"
    np.save(other, ~shape("c").occupancy)
    status, out, _ = run(capsys, "certify", path, other, "--json")
    result = json.loads(out)
    assert (status, result["proven"], result["same_indicator"]) == (1, False, False)
    assert result["certificate"]["kind"] == "refuted"
    assert result["certificate"]["query"] == query


@each
def test_info(fitted, capsys):
    query, path, result = fitted
    proven = KINDS[query] == "proven"
    status, out, err = run(capsys, "info", path)
    assert (status, err) == (0 if proven else 1, "")
    words = ["mlp, 2D", query, KINDS[query], "not proven", "what is proven" if proven else "what is known"]
    words += ["0.75 (object units)"] if query == "ray" else []
    claim = f"No {query} that meets the object is ever answered with no."
    words += [claim, "input error", "CPU or CUDA"]
    assert all(word in out for word in words), out
    assert len(out.splitlines()) < 25
    assert max(map(len, out.splitlines())) <= 110
    assert "fresh positives in" not in out
    status, out, _ = run(capsys, "info", path, "--json")
    held = json.loads(out)
    assert status == (0 if proven else 1)
    assert (held["query"], held["dimension"]) == (query, 2)
    assert held["length"] == (0.75 if query == "ray" else None)
    assert held["certificate"] == result["certificate"]
    assert ("what is proven" in held["statement"]) == proven
    assert "not proven" in held["statement"]


def test_info_of_what_is_not_proven(tmp_path, capsys, monkeypatch):
    path = tmp_path / "s.safetensors"
    bounder = without_proof(monkeypatch)
    attest(bounder, shape("c"), least=0.0, room=20.0, count=10_000)
    bounder.save(path)
    status, out, err = run(capsys, "info", path)
    assert (status, err) == (1, "")
    assert all(
        word in out for word in ("statistical", "not proven", "what is known", "alpha = 0.05", "half uniform")
    ), out
    assert "fresh positives in" in out
    np.save(tmp_path / "c.npy", shape("c").occupancy)
    status, out, _ = run(capsys, "certify", path, tmp_path / "c.npy")
    assert status == 1
    assert out.startswith("statistical")
    assert "not proven" in out


BAD = {
    "query": (["--query", "cone"], "point, ray, plane, box"),
    "space": (["--query", "ray", "--space", "parametric"], "space"),
    "length 0": (["--query", "ray", "--length", "0"], "length"),
    "length below 0": (["--query", "ray", "--length", "-1"], "length"),
    "length nan": (["--query", "ray", "--length", "nan"], "length"),
    "length infinite": (["--query", "ray", "--length", "inf"], "length"),
    "length words": (["--query", "ray", "--length", "long"], "length"),
    "too long for float32": (["--query", "ray", "--length", "1e6"], "length"),
    "voxels": (["--query", "box", "--method", "voxels"], "voxels"),
}


@pytest.mark.parametrize("bad", BAD)
def test_bad_options(bad, picture, tmp_path, capsys):
    options, word = BAD[bad]
    path = tmp_path / "b.safetensors"
    status, out, err = run(capsys, "fit", picture, "-o", path, *FIT, *options)
    check_bad(status, out, err)
    assert word in err
    assert not path.exists()


def test_an_unknown_protocol(picture, tmp_path, capsys):
    path = tmp_path / "b.safetensors"
    assert run(capsys, "fit", picture, "-o", path, "--query", "box", "--method", "aabb", "--samples", 1000)[0] == 0
    check_bad(*run(capsys, "evaluate", path, picture, "--protocol", "guess"))
