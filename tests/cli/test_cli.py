"""The command line: exit status, one JSON object or text, one clear line for what is wrong."""

import json
import os
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from bounding_shapes import HIDDEN, shape
from commands import check_bad, run

import warp_bounding as wb

ROOT = Path(__file__).parents[2]
WIDTHS = ",".join(map(str, HIDDEN))
CERTIFICATE_KEYS = {"kind", "query", "threshold", "lower_bound", "rounding_bound", "boxes", "seconds"}


@pytest.fixture
def files(tmp_path):
    np.save(tmp_path / "c.npy", shape("c").occupancy)
    np.save(tmp_path / "other.npy", ~shape("c").occupancy)
    np.save(tmp_path / "blob.npy", shape("blob").occupancy)
    return tmp_path


def command(*arguments, module=True):
    """A command in a process of its own."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "COLUMNS": "200"}
    return subprocess.run(
        [sys.executable, "-m", "warp_bounding", *map(str, arguments)],
        capture_output=True,
        text=True,
        env=environment,
        check=False,
    )


def fit(capsys, files, *options, name="b", source="c.npy", method="aabb"):
    path = files / f"{name}.safetensors"
    return path, run(capsys, "fit", files / source, "-o", path, "--method", method, "--samples", 20_000, *options)


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


@pytest.mark.parametrize("arguments", [("--help",), ("fit", "--help")])
def test_processes_give_help(arguments):
    done = command(*arguments)
    assert done.returncode == 0
    assert "Usage" in done.stdout
    assert done.stderr == ""


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
    assert out.startswith("proven")
    assert "not the shape that the file's certificate is about" in out
    assert shape("c").digest[:16] in out
    assert "given here" in out
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


BAD = {
    "nothing known": ["dance"],
    "no such option": ["fit", "{c}", "-o", "{out}", "--speed", "9"],
    "no output": ["fit", "{c}"],
    "no shape": ["fit"],
    "unknown method": ["fit", "{c}", "-o", "{out}", "--method", "magic"],
    "unknown query": ["fit", "{c}", "-o", "{out}", "--query", "cone"],
    "missing shape": ["fit", "{dir}/none.npy", "-o", "{out}"],
    "voxels have no rule for boxes": ["fit", "{c}", "-o", "{out}", "--query", "box", "--method", "voxels"],
    "networks have no parametric space": ["fit", "{c}", "-o", "{out}", "--query", "box", "--space", "parametric"],
    "hidden 0": ["fit", "{c}", "-o", "{out}", "--hidden", "0"],
    "hidden words": ["fit", "{c}", "-o", "{out}", "--hidden", "wide"],
    "hidden nothing": ["fit", "{c}", "-o", "{out}", "--hidden", ""],
    "budget 0": ["fit", "{c}", "-o", "{out}", "--budget", "0"],
    "budget words": ["fit", "{c}", "-o", "{out}", "--budget", "long"],
    "budget with a unit": ["fit", "{c}", "-o", "{out}", "--budget", "1m"],
    "budget nan": ["fit", "{c}", "-o", "{out}", "--budget", "nan"],
    "seed": ["fit", "{c}", "-o", "{out}", "--seed", "-1"],
    "steps": ["fit", "{c}", "-o", "{out}", "--steps", "0"],
    "options of other methods": ["fit", "{c}", "-o", "{out}", "--method", "aabb", "--k", "5", "--leaves", "7"],
    "steps of a closed form": ["fit", "{c}", "-o", "{out}", "--method", "kdop", "--steps", "7"],
    "length of points": ["fit", "{c}", "-o", "{out}", "--method", "aabb", "--length", "2"],
    "space of points": ["fit", "{c}", "-o", "{out}", "--method", "aabb", "--space", "parametric"],
    "samples": ["fit", "{c}", "-o", "{out}", "--method", "aabb", "--samples", "0"],
    "margin": ["fit", "{c}", "-o", "{out}", "--method", "aabb", "--margin", "-1"],
    "octaves": ["fit", "{c}", "-o", "{out}", "--octaves", "-1"],
    "activation": ["fit", "{c}", "-o", "{out}", "--activation", "steps"],
    "recipe": ["fit", "{c}", "-o", "{out}", "--recipe", "soup"],
    "k": ["fit", "{c}", "-o", "{out}", "--method", "kdop", "--k", "5"],
    "device": ["fit", "{c}", "-o", "{out}", "--method", "aabb", "--device", "cuda:99"],
    "output is a folder": ["fit", "{c}", "-o", "{dir}", "--method", "aabb"],
    "output is the shape": ["fit", "{c}", "-o", "{c}", "--method", "aabb"],
    "output is another shape": ["fit", "{c}", "-o", "{blob}", "--method", "aabb"],
    "output is what is not a bounder": ["fit", "{c}", "-o", "{notes}", "--method", "aabb"],
    "output nothing": ["fit", "{c}", "-o", "", "--method", "aabb"],
    "output with a null byte": ["fit", "{c}", "-o", "{dir}/a\0b.safetensors", "--method", "aabb"],
    "output below a file": ["fit", "{c}", "-o", "{c}/b.safetensors", "--method", "aabb"],
    "empty shape": ["fit", "{empty}", "-o", "{out}", "--method", "aabb"],
    "certify nothing": ["certify", "{dir}/none.safetensors", "{c}"],
    "certify a shape": ["certify", "{c}", "{c}"],
    "certify without shape": ["certify", "{out}"],
    "certify a missing shape": ["certify", "{out}", "{dir}/none.npy"],
    "certify no margin": ["certify", "{out}", "{c}", "--margin", "nan"],
    "certify a negative margin": ["certify", "{out}", "{c}", "--margin", "-1"],
    "certify rays of no length": ["certify", "{out}", "{c}", "--length", "0"],
    "certify no resolution": ["certify", "{out}", "{c}", "--resolution", "0"],
    "certify an unknown query": ["certify", "{out}", "{c}", "--query", "cone"],
    "certify in no time": ["certify", "{out}", "{c}", "--budget", "0"],
    "evaluate nothing": ["evaluate", "{dir}/none.safetensors", "{c}"],
    "evaluate no samples": ["evaluate", "{out}", "{c}", "--samples", "0"],
    "evaluate for ever": ["evaluate", "{out}", "{c}", "--samples", "1e20"],
    "evaluate protocol": ["evaluate", "{out}", "{c}", "--protocol", "guess"],
    "evaluate dimension": ["evaluate", "{out}", "{blob}"],
    "evaluate half a sample": ["evaluate", "{out}", "{c}", "--samples", "1.5"],
    "evaluate swapped": ["evaluate", "{c}", "{out}"],
    "certify swapped": ["certify", "{c}", "{out}"],
    "info of a folder": ["info", "{dir}"],
    "info of a shape": ["info", "{c}"],
    "query nothing": ["query", "{out}", "{dir}/none.npy", "-o", "{dir}/m.npy"],
    "query no bounder": ["query", "{c}", "{c}", "-o", "{dir}/m.npy"],
    "query what are no queries": ["query", "{out}", "{c}", "-o", "{dir}/m.npy"],
    "query what is no array": ["query", "{out}", "{out}", "-o", "{dir}/m.npy"],
    "query over a folder": ["query", "{out}", "{c}", "-o", "{dir}"],
    "query over the queries": ["query", "{out}", "{c}", "-o", "{c}"],
    "query over the bounder": ["query", "{out}", "{q}", "-o", "{dir}/./out.safetensors"],
    "query over what is no mask": ["query", "{out}", "{q}", "-o", "{notes}"],
    "query a folder": ["query", "{out}", "{dir}", "-o", "{dir}/m.npy"],
    "query on no device": ["query", "{out}", "{c}", "-o", "{dir}/m.npy", "--device", "cuda:99"],
    "info nothing": ["info", "{dir}/none.safetensors"],
    "demo": ["demo", "dancing"],
    "demo budget": ["demo", "particles", "--budget", "5"],
    "demo option": ["demo", "particles", "--world", "maze.png"],
    "demo seed": ["demo", "particles", "--seed", "-1"],
    "demo particles": ["demo", "particles", "--particles", "0"],
}


@pytest.mark.parametrize("bad", BAD)
def test_bad_usage(files, capsys, bad):
    out, _ = fit(capsys, files, name="out")
    np.save(files / "empty.npy", np.zeros((3, 3)))
    np.save(files / "q.npy", np.zeros((3, 2)))
    (files / "notes.txt").write_text("notes")
    names = {name: files / f"{name}.npy" for name in ("c", "blob", "empty", "q")}
    names |= {"dir": files, "out": out, "notes": files / "notes.txt"}
    before = {path.name: path.read_bytes() for path in files.iterdir()}
    check_bad(*run(capsys, *(word.format(**names) for word in BAD[bad])))
    assert {path.name: path.read_bytes() for path in files.iterdir()} == before


def test_help_and_refusals_read_what_the_methods_state(files, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "240")
    status, out, _ = run(capsys, "fit", "--help")
    assert status == 0
    for kind in wb.METHODS.values():
        for option in kind.options:
            assert f"--{option.name} " in out
            assert option.help[:20] in out
    status, out, err = run(
        capsys, "fit", files / "c.npy", "-o", files / "b.safetensors", "--method", "kdop", "--leaves", 7
    )
    assert (status, out) == (2, "")
    assert err == "warp-bounding: kdop takes k for point queries, got leaves\n"


@pytest.mark.parametrize(
    ("option", "text", "told"),
    [
        ("--budget", "1m", "--budget must be a number, got '1m' "),
        ("--seed", "1.5", "--seed must be a whole number, got '1.5' "),
    ],
)
def test_what_is_no_number_is_shown(files, capsys, option, text, told):
    err = run(capsys, "fit", files / "c.npy", "-o", files / "b.safetensors", option, text)[2]
    assert err.startswith(f"warp-bounding: {told}")


def test_paths_are_no_markup(files, capsys):
    """Brackets in a file's name are text, whatever the library that prints makes of them."""
    odd = "[red]x :smile:"
    (files / "c.npy").rename(files / f"{odd}.npy")
    shape_file, path = (files / f"{odd}{suffix}" for suffix in (".npy", ".safetensors"))
    mask = files / "[" / f"bold]{odd}.npy"  # read as markup, this ends what has never begun
    np.save(files / "points.npy", np.zeros((2, 2), np.float32))
    outputs = [
        run(capsys, "fit", shape_file, "-o", path, "--method", "aabb", "--samples", "1e4"),
        run(capsys, "query", path, files / "points.npy", "-o", mask),
        run(capsys, "certify", path, shape_file),
        run(capsys, "info", path),
    ]
    for status, out, err in outputs:
        assert (status, err) == (0, "")
        assert odd in out


@pytest.mark.parametrize("name", ["fit", "soak", "table1"])
def test_help_fills_its_lines(capsys, monkeypatch, name):
    """A docstring's own line breaks are no breaks in a narrower terminal: no line has room for the next one's first word."""
    monkeypatch.setenv("COLUMNS", "80")
    lines = [line.strip() for line in run(capsys, name, "--help")[1].partition("╭")[0].splitlines()]
    for line, following in pairwise(lines):
        if line and following:
            assert len(line) + 1 + len(following.split()[0]) > 78


@pytest.mark.skipif(os.name != "posix", reason="a shell that closes a stream")
@pytest.mark.parametrize("stream", [1, 2])
def test_a_closed_stream_is_nobody_listening(files, capsys, stream):
    path, _ = fit(capsys, files)
    line = f'"{sys.executable}" -m warp_bounding info "{path}" {stream}>&-'
    done = subprocess.run(
        line, shell=True, capture_output=True, text=True, env=os.environ | {"PYTHONPATH": str(ROOT)}, check=False
    )
    assert done.returncode == 0
    assert done.stderr == ""
    assert ("proven" in done.stdout) == (stream == 2)


def test_ctrl_c_while_modules_are_imported(capsys, monkeypatch):
    import builtins

    real = builtins.__import__

    def interrupted(name, *rest):
        if name == "warp_bounding.cli.output":
            raise KeyboardInterrupt
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", interrupted)
    status, out, err = run(capsys, "info", "b.safetensors")
    assert (status, out, err) == (1, "", "interrupted\n")


def test_version(capsys):
    assert run(capsys, "--version") == (0, f"warp-bounding {wb.__version__}\n", "")


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


def test_swapped_arguments_and_shapes_are_named(files, capsys):
    path, _ = fit(capsys, files)
    (files / "x.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    for arguments in (
        ("info", files / "x.obj"),
        ("certify", files / "x.obj", path),
        ("evaluate", files / "x.obj", path),
    ):
        _, _, err = run(capsys, *arguments)
        assert err.startswith(f"warp-bounding: {files / 'x.obj'}: expected a bounder that fit wrote, got a mesh file; ")
        assert "the bounder comes first, then the shape" in err
    assert "got an array, image or voxel file" in run(capsys, "certify", files / "c.npy", path)[2]
    assert "a folder, expected the file of a bounder" in run(capsys, "info", files)[2]


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
