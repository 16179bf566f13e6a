"""The command line: exit status, one JSON object or text."""

import json

import numpy as np
import pytest
from bounding_shapes import shape
from commands import WIDTHS, check_bad, command, fit, run

import warp_bounding as wb

CERTIFICATE_KEYS = {"kind", "query", "threshold", "lower_bound", "rounding_bound", "boxes", "seconds"}


def test_processes_fit_certify_another_shape_and_damage(files):
    path = files / "b.safetensors"
    done = command("fit", files / "c.npy", "-o", path, "--hidden", WIDTHS, "--steps", 5, "--samples", 20_000, "--json")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert {"fp_rate", "fn", "samples", "fit_seconds", "certificate", "path"} <= set(result)
    assert set(result["certificate"]) >= CERTIFICATE_KEYS
    assert (result["fn"], result["certificate"]["kind"], result["path"]) == (0, "proven", str(path))
    assert "Traceback" not in done.stderr
    good = command("certify", path, files / "c.npy", "--json")
    assert good.returncode == 0
    assert json.loads(good.stdout)["certificate"]["kind"] == "proven"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    damaged = command("certify", path, files / "c.npy", "--json")
    check_bad(damaged.returncode, damaged.stdout, damaged.stderr)


def test_certify(files, capsys):
    path, (status, out, _) = fit(capsys, files)
    assert status == 0
    assert "false positives" in out
    status, out, _ = run(capsys, "certify", path, files / "c.npy")
    assert status == 0
    assert "proven" in out
    status, out, _ = run(capsys, "certify", path, files / "other.npy", "--json")
    result = json.loads(out)
    assert status == 1
    assert result["certificate"]["kind"] == "refuted"
    assert result["same_indicator"] is False
    assert len(result["certificate"]["counterexample"]) == 2
    assert result["certified_indicator"] == shape("c").digest != result["certificate"]["indicator"]
    status, out, _ = run(capsys, "certify", path, files / "blob.npy")
    assert status == 1
    assert "inapplicable: the shape is 3D, the bounder 2D" in out


def test_certify_a_shape_that_is_not_the_certified_one(files, capsys):
    """The geometry decides: a part of the shape is proven too, and the text says that it is another shape."""
    path, _ = fit(capsys, files)
    part = shape("c").occupancy.copy()
    part[2:4] = False
    np.save(files / "part.npy", part)
    status, out, _ = run(capsys, "certify", path, files / "part.npy")
    assert status == 0
    first, second = out.splitlines()[:2]
    assert "part.npy is not the shape that the bounder was fitted to" in first
    assert shape("c").digest[:16] in first
    assert second.startswith("proven")
    status, out, _ = run(capsys, "certify", path, files / "c.npy")
    assert status == 0
    assert "not the shape" not in out


@pytest.mark.parametrize("query", ["point", "ray", "box"])
def test_certify_a_shape_that_the_domain_does_not_hold(files, capsys, query):
    """Voxels at their place, but more of them than the bounder was made for."""
    import trimesh

    meshes = {}
    for name, size in (("small", 1.0), ("large", 2.0)):
        meshes[name] = files / f"{name}.ply"
        trimesh.creation.box((size, size, size)).export(meshes[name])
    options = ("--query", query, "--resolution", 8)
    path, (status, *_) = fit(capsys, files, *options, source="small.ply")
    assert status == 0
    status, out, err = run(capsys, "certify", path, meshes["large"])
    assert status == 1
    assert "outside the domain" in out
    assert err == ""


@pytest.mark.parametrize("query", ["point", "ray", "plane", "box"])
def test_a_budget_too_small_ends_honestly(files, capsys, query):
    options = ("--query", query, "--hidden", WIDTHS, "--budget", 0.01, "--json")
    path, (status, out, _) = fit(capsys, files, *options, method="mlp")
    result = json.loads(out)
    assert status == 0
    assert result["fn"] == 0
    certificate = result["certificate"]
    assert certificate["kind"] in ("proven", "statistical")
    assert (certificate["samples"] > 0) == (certificate["kind"] == "statistical")
    assert wb.load(path, device="cpu").certificate.kind == certificate["kind"]
    status, out, _ = run(capsys, "certify", path, files / "c.npy", "--budget", 0.01, "--json")
    again = json.loads(out)
    assert status == (0 if again["proven"] else 1)
    honest = {"proven", "undecided"} if certificate["kind"] == "proven" else {"proven", "undecided", "refuted"}
    assert again["certificate"]["kind"] in honest  # fresh positives may refute what fewer of them let pass


@pytest.mark.parametrize("method", ["aabb", "voxels", "mlp"])
def test_json_is_one_object_and_nothing_else(files, capsys, method):
    told = ("--hidden", WIDTHS, "--steps", 3) if method == "mlp" else ()
    path, (status, out, err) = fit(capsys, files, "--json", *told, method=method)
    assert status == 0
    assert len(out.strip().splitlines()) == 1
    fitted = json.loads(out)
    assert set(fitted["certificate"]) >= CERTIFICATE_KEYS
    status, out, _ = run(capsys, "evaluate", path, files / "c.npy", "--samples", 20_000, "--json")
    rates = json.loads(out)
    assert status == 0
    assert len(out.strip().splitlines()) == 1
    assert {"fp_rate", "fn", "samples", "path", "certificate"} <= set(rates)
    assert (rates["fp_rate"], rates["fn"], rates["samples"]) == (fitted["fp_rate"], 0, 20_000)
    status, out, err = run(capsys, "info", path, "--json")
    info = json.loads(out)
    assert status == 0
    assert err == ""
    assert (info["method"], info["dimension"], info["query"]) == (method, 2, "point")
    assert info["certificate"] == fitted["certificate"]


def test_text_for_people(files, capsys):
    path, _ = fit(capsys, files, "--hidden", WIDTHS, "--steps", 3, method="mlp")
    status, out, err = run(capsys, "info", path)
    assert status == 0
    assert err == ""
    assert all(word in out for word in ("mlp", "proven", "threshold", "arithmetic", "not proven"))
    status, out, _ = run(capsys, "evaluate", path, files / "c.npy", "--samples", 5000)
    assert status == 0
    assert "0 false negatives" in out


def test_evaluate_finds_a_false_negative(files, capsys):
    path, _ = fit(capsys, files)
    assert run(capsys, "evaluate", path, files / "other.npy", "--samples", 5000)[0] == 1


def test_info_of_what_is_not_proven(files, capsys):
    from bounding_shapes import random_mlp

    path = files / "b.safetensors"
    random_mlp(shape("c")).save(path)
    status, out, _ = run(capsys, "info", path)
    assert status == 1
    assert "none" in out
    status, out, _ = run(capsys, "info", path, "--json")
    assert status == 1
    assert json.loads(out)["certificate"] is None


def test_fits_are_repeatable(files, capsys):
    paths = [fit(capsys, files, "--hidden", WIDTHS, "--steps", 4, "--seed", 3, name=n, method="mlp")[0] for n in "ab"]
    from safetensors.numpy import load_file

    first, second = (load_file(path) for path in paths)
    assert all(first[k].tobytes() == second[k].tobytes() for k in first)


def test_query_writes_a_mask(files, capsys, rng):
    path, _ = fit(capsys, files)
    bounder = wb.load(path, device="cpu")
    for dtype, count in ((np.float32, 1000), (np.float64, 7), (np.float32, 0)):
        points = rng.random((count, 2)).astype(dtype)
        np.save(files / "points.npy", points)
        status, out, err = run(capsys, "query", path, files / "points.npy", "-o", files / "new/mask.npy", "--json")
        mask, result = np.load(files / "new/mask.npy"), json.loads(out)
        assert (status, err) == (0, "")
        assert (mask.dtype, mask.shape) == (np.uint8, (count,))
        assert (mask == bounder.query(points).numpy()).all()
        assert (result["count"], result["maybe"], result["query"]) == (count, mask.sum(), "point")
    status, out, _ = run(capsys, "query", path, files / "points.npy", "-o", files / "mask.npy")
    assert status == 0
    assert "maybe for 0 of 0 point queries" in out


def test_query_leaves_an_older_mask_where_it_fails(files, capsys):
    path, _ = fit(capsys, files)
    np.save(files / "points.npy", np.zeros((5, 3), np.float32))
    (files / "mask.npy").write_text("older")
    check_bad(*run(capsys, "query", path, files / "points.npy", "-o", files / "mask.npy"))
    assert (files / "mask.npy").read_text() == "older"


def test_evaluate_says_first_that_it_is_another_shape(files, capsys):
    path, _ = fit(capsys, files)
    status, out, _ = run(capsys, "evaluate", path, files / "other.npy", "--samples", "5e3")
    assert status == 1
    first, second = out.splitlines()
    assert "other.npy is not the shape that the bounder was fitted to" in first
    assert shape("c").digest[:16] in first
    assert "false negatives" in second
    assert "5,000 samples" in second
    status, out, _ = run(capsys, "evaluate", path, files / "other.npy", "--samples", 5000, "--json")
    result = json.loads(out)
    assert (result["same_indicator"], result["fitted_indicator"]) == (False, shape("c").digest)
    assert result["indicator"] == wb.load_indicator(files / "other.npy").digest
    status, out, _ = run(capsys, "evaluate", path, files / "c.npy", "--samples", 5000, "--json")
    assert json.loads(out)["same_indicator"] is True
    assert "not the shape" not in run(capsys, "evaluate", path, files / "c.npy", "--samples", 5000)[1]


def test_a_bounder_that_is_looser_than_a_box_is_told(files, capsys):
    """A network of one neuron and one step, against a box."""
    options = ("--hidden", 1, "--steps", 1, "--seed", 2)
    path, (status, _, err) = fit(capsys, files, *options, method="mlp")
    assert status == 0
    assert err.startswith("looser than a box: ")
    assert "a longer budget makes it tighter" in err
    result = json.loads(fit(capsys, files, *options, "--json", method="mlp")[1][1])
    assert result["warning"].startswith("looser than a box")
    rates = wb.load(path).info["rates"]
    assert rates["fp_rate"] > rates["fp_rate_aabb"]
    assert "looser than a box" in run(capsys, "info", path)[1]


def test_a_fit_that_had_no_time_says_so(files, capsys):
    """Where it was the time; of steps that are asked for, nobody is surprised."""
    for asked, told in ((("--budget", 0.02), True), (("--steps", 4), False)):
        status, _, err = run(capsys, "fit", files / "c.npy", "-o", files / "few.safetensors", "--method", "mlp", *asked)
        assert status == 0
        assert ("hardly trained" in err or "looser than a box" in err) if told else "hardly trained" not in err
    path, (_, _, err) = fit(capsys, files)
    assert err == ""
    assert json.loads(run(capsys, "info", path, "--json")[1])["rates"] == wb.load(path).info["rates"]


def test_what_compiling_takes_is_told_apart(files, capsys, monkeypatch, ticking):
    """The clock of a fit stands still while kernels are compiled; here each of them takes long."""
    from warp_bounding.runtime import launch

    monkeypatch.setattr(launch, "_ready", set())
    clock = ticking(0.001)
    monkeypatch.setattr(launch.wp, "load_module", lambda *_: clock.wait(0.3))
    _, (status, out, _) = fit(capsys, files, "--hidden", WIDTHS, "--budget", 0.2, "--json", method="mlp")
    result = json.loads(out)
    assert status == 0
    assert result["compile_seconds"] >= 0.6
    assert result["fit_seconds"] >= result["compile_seconds"]
    assert result["training"]["steps"] > 0
