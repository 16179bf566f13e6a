"""The command line as it is called: help, versions, closed streams, and one clear line for what is wrong."""

import os
import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest
from commands import ROOT, check_bad, command, fit, run

import warp_bounding as wb

BAD = {
    "nothing known": ["dance"],
    "no such option": ["fit", "{c}", "-o", "{out}", "--speed", "9"],
    "no output": ["fit", "{c}"],
    "no shape": ["fit"],
    "unknown method": ["fit", "{c}", "-o", "{out}", "--method", "magic"],
    "unknown query": ["fit", "{c}", "-o", "{out}", "--query", "cone"],
    "missing shape": ["fit", "{dir}/none.npy", "-o", "{out}"],
    "voxels have no rule for boxes": ["fit", "{c}", "-o", "{out}", "--query", "box", "--method", "voxels"],
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
    assert (
        err
        == "warp-bounding: kdop takes no option 'leaves'; beside the arguments of fit, kdop takes k for point queries\n"
    )


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


@pytest.mark.parametrize("arguments", [("--help",), ("fit", "--help")])
def test_processes_give_help(arguments):
    done = command(*arguments)
    assert done.returncode == 0
    assert "Usage" in done.stdout
    assert done.stderr == ""


@pytest.mark.parametrize(("name", "now"), [("demo", "python -m sims"), ("table1", "python -m paper table1")])
def test_commands_that_have_left_the_package_say_what_replaces_them(name, now):
    done = command(name, "--help")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == f"warp-bounding: {name} is no command any more; in a clone of the repository: {now}\n"
