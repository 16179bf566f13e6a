"""The commands, from fit to query: exit status, one JSON object or text."""

import json
import re

import numpy as np
import pytest
from bounding_shapes import random_mlp, shape
from commands import WIDTHS, check_bad, fit, run
from PIL import Image

import warp_bounding as wb
from warp_bounding.proof import statistical_test

CERTIFICATE_KEYS = {"kind", "query", "threshold", "lower_bound", "rounding_bound", "boxes", "seconds"}
FEW = ("--samples", 5000)


def as_json(capsys, *arguments, status=0):
    """The one object that a command prints."""
    code, out, _ = run(capsys, *arguments, "--json")
    assert code == status
    assert len(out.strip().splitlines()) == 1
    return json.loads(out)


NETWORK = ("mlp", "--steps", 20, "--hidden", WIDTHS)
FITTED = {"point": NETWORK, "ray": ("kdop", "--length", 0.75)}


@pytest.mark.parametrize("query", ["point", "ray", "plane", "box"])
def test_each_kind_of_query(files, capsys, query):
    """Fit, info, evaluate and certify agree."""
    method, *own = FITTED.get(query, ("bvh",))
    path, (status, out, _) = fit(capsys, files, "--query", query, *own, "--json", method=method)
    fitted = json.loads(out)
    assert status == 0
    assert {"fp_rate", "fn", "samples", "fit_seconds", "certificate", "path"} <= set(fitted)
    assert (fitted["query"], fitted["method"], fitted["fn"], fitted["path"]) == (query, method, 0, str(path))
    assert set(fitted["certificate"]) >= CERTIFICATE_KEYS
    assert fitted["certificate"]["kind"] == "proven"
    info = as_json(capsys, "info", path)
    assert (info["query"], info["dimension"], info["length"]) == (query, 2, 0.75 if query == "ray" else None)
    assert info["certificate"] == fitted["certificate"]
    assert "what is proven" in info["statement"]
    rates = as_json(capsys, "evaluate", path, files / "c.npy", "--samples", 20_000)
    assert (rates["fn"], rates["fp_rate"]) == (0, fitted["fp_rate"])
    assert rates["positives"] > 0
    again = as_json(capsys, "certify", path, files / "c.npy")
    assert (again["proven"], again["same_indicator"]) == (True, True)
    other = as_json(capsys, "certify", path, files / "other.npy", status=1)
    assert (other["certificate"]["kind"], other["same_indicator"]) == ("refuted", False)
    status, out, err = run(capsys, "info", path)
    assert (status, err) == (0, "")
    assert "is ever answered with no." in " ".join(out.split())
    assert max(map(len, out.splitlines())) <= 110


def test_certify_tells_another_shape_and_never_proves_a_wrong_one(files, capsys):
    path, (status, out, _) = fit(capsys, files)
    assert status == 0
    assert "false positives" in out
    status, out, _ = run(capsys, "certify", path, files / "c.npy")
    assert (status, "proven" in out, "not the shape" in out) == (0, True, False)
    refuted = as_json(capsys, "certify", path, files / "other.npy", status=1)
    assert len(refuted["certificate"]["counterexample"]) == 2
    assert refuted["fitted_indicator"] == shape("c").digest != refuted["certificate"]["indicator"]
    status, out, _ = run(capsys, "certify", path, files / "blob.npy")
    assert (status, "inapplicable: the shape is 3D, the bounder 2D" in out) == (1, True)
    part = shape("c").occupancy.copy()  # the geometry decides: a part of the shape is proven, too
    part[2:4] = False
    np.save(files / "part.npy", part)
    for words in (("certify",), ("evaluate", "--stress", 1000)):
        status, _, err = run(capsys, words[0], path, files / "part.npy", *words[1:])
        assert status == 0
        assert err.startswith("part.npy is not the shape that the bounder was fitted to")
    assert as_json(capsys, "evaluate", path, files / "other.npy", *FEW, status=1)["same_indicator"] is False


def test_another_claim_than_the_expected_one_is_not_proven(files, capsys):
    path, _ = fit(capsys, files, "--query", "ray", "--margin", 0.05, "--length", 0.5)
    assert run(capsys, "certify", path, files / "c.npy", "--margin", 0.05, "--length", 0.5, "--query", "ray")[0] == 0
    status, out, _ = run(capsys, "certify", path, files / "c.npy", "--margin", 0.1)
    assert (status, "expected margin 0.1, the bounder is for margin 0.05" in out) == (1, True)


def test_rays_and_boxes_get_a_tree_of_boxes_without_a_method(files, capsys):
    for query in ("ray", "box"):
        words = ("fit", files / "c.npy", "-o", files / "b.safetensors", "--query", query, "--samples", 1000)
        found = as_json(capsys, *words)
        assert (found["method"], found["certificate"]["kind"]) == ("bvh", "proven")


def test_what_is_not_proven_is_said(files, capsys):
    path = files / "b.safetensors"
    random_mlp(shape("c")).save(path)
    assert run(capsys, "info", path)[0] == 1
    assert as_json(capsys, "info", path, status=1)["certificate"] is None
    bounder = random_mlp(shape("c"))
    bounder.info = {"indicator": shape("c").digest, "margin": 0.0, "seed": 0}
    statistical_test(bounder, shape("c"), least=0.0, below=20.0, count=10_000)
    bounder.save(path)
    status, out, err = run(capsys, "info", path)
    assert (status, err) == (1, "")
    shown = " ".join(out.split())
    assert all(word in shown for word in ("statistical", "not proven", "what is known", "at 95% confidence"))
    status, out, _ = run(capsys, "certify", path, files / "c.npy")
    assert (status, out.partition(":")[0]) == (0, "proven")  # what was sampled may be proven


def test_query_writes_a_mask_or_leaves_the_older_one(files, capsys, rng):
    path, _ = fit(capsys, files)
    bounder, mask_file = wb.load(path, device="cpu"), files / "new" / "mask.npy"
    for dtype, count in ((np.float32, 1000), (np.float64, 7), (np.float32, 0)):
        points = rng.random((count, 2)).astype(dtype)
        np.save(files / "points.npy", points)
        found = as_json(capsys, "query", path, files / "points.npy", "-o", mask_file)
        mask = np.load(mask_file)
        assert (mask.dtype, mask.shape) == (bool, (count,))
        assert (mask == bounder.query(points).numpy()).all()
        assert (found["count"], found["maybe"], found["query"]) == (count, mask.sum(), "point")
    assert "maybe for 0 of 0 point queries" in run(capsys, "query", path, files / "points.npy", "-o", mask_file)[1]
    np.save(files / "points.npy", np.zeros((5, 3), np.float32))
    mask_file.write_text("older")
    check_bad(*run(capsys, "query", path, files / "points.npy", "-o", mask_file))
    assert mask_file.read_text() == "older"


# --- shapes' files ----------------------------------------------------------------------------------------------------


def test_a_map_in_metres_from_fit_to_stress(capsys, tmp_path):
    grey = np.full((12, 20), 254, dtype=np.uint8)  # white is free
    grey[3:6, 4:9] = 10
    Image.fromarray(grey).save(tmp_path / "map.png")
    options = ("--level", "<128", "--spacing", "0.05", "--origin", "-0.5,2")
    path, (status, *_) = fit(capsys, tmp_path, *options, source="map.png")
    assert status == 0
    wall = np.array([[-0.5 + 4 * 0.05, 2 + 6 * 0.05], [-0.5 + 9 * 0.05, 2 + 6 * 0.05]], dtype=np.float32)
    assert wb.load(path, device="cpu").query(wall).numpy().tolist() == [1, 0]
    for name, *more in (["certify"], ["evaluate", *FEW], ["evaluate", "--stress", 1000]):
        assert as_json(capsys, name, path, tmp_path / "map.png", *more, *options).get("same_indicator", True)
    assert run(capsys, "certify", path, tmp_path / "map.png", "--level", "<128")[0] == 1  # other cells
    status, out, err = run(capsys, "fit", tmp_path / "map.png", "-o", tmp_path / "new.safetensors", "--method", "aabb")
    check_bad(status, out, err)
    assert "level='<128'" in err


# --- distances --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("method", "own"), [("kdop", ()), ("distance-grid", ("--nodes", 6, "--storage", "uint8"))])
def test_a_distance_from_fit_to_stress(method, own, files, capsys):
    source, options = files / "c.npy", ("--query", "distance", *own)
    path, (status, out, _) = fit(capsys, files, *options, "--json", method=method)
    fitted = json.loads(out)
    assert (status, fitted["method"], fitted["query"], fitted["fn"]) == (0, method, "distance", 0)
    assert fitted["certificate"]["kind"] == "proven"
    assert "never overestimated" in run(capsys, "info", path)[1]
    status, out, _ = run(capsys, "certify", path, source, "--query", "distance")
    assert (status, out.partition(":")[0]) == (0, "proven")
    rates = as_json(capsys, "evaluate", path, source, "--radius", 0.1, *FEW)
    assert (rates["fn"], rates["radius"]) == (0, 0.1)
    check_bad(*run(capsys, "evaluate", path, source, "--radius", "nan"))
    status, out, _ = run(capsys, "evaluate", path, source, "--stress", "1e5", "--seed", 3)
    assert (status, "none missed" in out) == (0, True)


# --- stress -----------------------------------------------------------------------------------------------------------


def test_stress_finds_a_false_negative_where_there_is_one(files, capsys):
    bounder, good, raised = wb.fit(shape("c"), "ray", "kdop", device="cpu"), files / "b.safetensors", files / "raised"
    bounder.save(good)
    bounder.freeze(float(bounder.threshold) + 0.01, None).save(raised)
    status, out, _ = run(capsys, "evaluate", good, files / "c.npy", "--stress", "1e5", "--seed", 7)
    assert (status, "none missed" in out, "seed 7" in out) == (0, True, True)
    words = ("evaluate", raised, files / "c.npy", "--stress", "1e6", "--seed", 7)
    status, out, _ = run(capsys, *words)
    assert status == 1
    assert re.match(r"FALSE NEGATIVE: the ray \[.*\] \(float32\) meets the shape and is answered with no", out)
    missed = np.array([as_json(capsys, *words, status=1)["missed"]], np.float32)
    assert wb.load(raised, device="cpu").query(missed).numpy()[0] == 0


# --- choose and bake --------------------------------------------------------------------------------------------------


@pytest.fixture
def disk(tmp_path):
    np.save(tmp_path / "disk.npy", np.linalg.norm(np.indices((12, 12)) - 5.5, axis=0) < 5)
    return tmp_path / "disk.npy"


def choose(capsys, disk, *options, price=5000, name="c"):
    output = disk.parent / f"{name}.safetensors"
    words = ("-o", output, "--narrow-ns", price, "--budget", 4, "--methods", "aabb,bvh,obb")
    return output, run(capsys, "choose", disk, *words, *options)


def test_what_is_chosen_is_written_and_a_choice_goes_on(capsys, disk):
    output, (status, out, err) = choose(capsys, disk)
    assert (status, err) == (0, "")
    assert "s a query in all" in out
    assert "Best by the narrow phase's price: none from 0 ns" in out
    assert f"candidates are kept in {output.with_suffix('.choice')}" in out
    assert "--workload x.npy asks those of your simulation" in out.splitlines()[0]
    assert output.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    assert wb.load(output, device="cpu").certificate.proven
    again, (status, out, err) = choose(
        capsys, disk, "--json", "--checkpoint", disk.parent / "c.choice", price=0, name="d"
    )
    found = json.loads(out)
    assert (status, found["label"], found["path"], again.exists()) == (0, "none", None, False)
    _, (status, out, _) = choose(capsys, disk, "--checkpoint", disk.parent / "c.choice", price="100,5000", name="e")
    assert (status, "100 ns if denied, 5000 ns if left" in out, "times" in out.splitlines()[2]) == (0, True, True)


# --- bake -------------------------------------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path):
    pytest.importorskip("distributed", reason="Dask is not installed")
    (tmp_path / "shapes").mkdir()
    for name in ("blob", "star"):
        np.save(tmp_path / "shapes" / f"{name}.npy", shape(name).occupancy)
    (tmp_path / "shapes" / "notes.txt").write_text("no shape")
    return tmp_path / "shapes"


def test_a_folder_is_baked_once(folder, capsys):
    out = folder.parent / "out"
    words = ("--output", out, "--method", "kdop", "--samples", 1000, "--jobs", 1)
    status, text, err = run(capsys, "bake", folder, *words, "--json")
    assert status == 0, err
    found = json.loads(text)
    assert [found[name] for name in ("shapes", "baked", "kept", "failed", "proven", "foreign")] == [2, 2, 0, 0, 2, 1]
    assert wb.baking.BounderLibrary(out, device="cpu").names == ["blob", "star"]
    status, text, _ = run(capsys, "bake", folder, *words)
    assert status == 0
    assert "2 shapes: 0 baked, 2 were there already, 0 failed; 2 proven" in text
