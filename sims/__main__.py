"""``python -m sims NAME``: the library at work on real input, with tables and pictures, in a clone."""

from dataclasses import fields
from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer

from sims import DEMOS
from warp_bounding.cli import Device, Json, Seed, count, main, number_option, print_json, quiet_warp
from warp_bounding.errors import BoundingError
from warp_bounding.runtime.whole_file import write_whole

__all__ = ["command", "run"]

NEEDED = ("newton", "pyvista", "scipy", "torch", "trimesh", "matplotlib")  # packages of the extra ``sims``


def command(
    name: Annotated[str | None, typer.Argument(metavar="NAME", help=f"Which: {', '.join(DEMOS)}.")] = None,
    assets: Annotated[
        str | None,
        typer.Option(help="Write bunny.obj and other meshes from installed packages to this folder, instead."),
    ] = None,
    out: Annotated[str, typer.Option("--output", "-o", help="Folder for pictures and fitted bounders.")] = "out/demo",
    quick: Annotated[bool, typer.Option("--quick", help="A small form of the demo, for a first look.")] = False,
    refit: Annotated[bool, typer.Option("--refit", help="Fit the networks anew, rather than load them.")] = False,
    budget: Annotated[float | None, typer.Option(help="Seconds a network, with --refit or --world.")] = None,
    bounder: Annotated[str | None, typer.Option(help="A file to take the network `mlp` from.")] = None,
    world: Annotated[str | None, typer.Option(help="path: image, array or .map file, or a folder of them.")] = None,
    particles: Annotated[int | None, number_option("particles: how many.", count)] = None,
    steps: Annotated[int | None, number_option("Simulation steps; shadows: pictures, digits: batches.", count)] = None,
    seed: Seed = 0,
    device: Device = "cpu",
    json: Json = False,
) -> int:
    """Run a demo. Exit status 1 if it finds its own promise broken."""
    if assets is not None:
        if name is not None:
            raise BoundingError(f"--assets writes meshes and runs no demo, got {name!r} too")
        return _write_assets(assets, json)
    if name not in DEMOS:
        raise BoundingError(f"demo must be one of {', '.join(DEMOS)}, got {name or 'none'}")
    if budget is not None and not refit and world is None:
        raise BoundingError("budget is for --refit or --world, where networks are fitted; else they are loaded")
    quiet_warp(device)
    given = {"bounder_file": bounder, "world": world, "particles": particles, "steps": steps}
    options = {key: value for key, value in given.items() if value is not None}
    try:
        from sims.report import output

        demo = import_module(f"sims.{name}")
        for option in options.keys() - {field.name for field in fields(demo.Demo)}:
            raise BoundingError(f"demo {name} has no option --{option.removesuffix('_file')}")
        common = {"quick": quick, "refit": refit, "budget": budget, "seed": seed, "device": device}
        result = demo.run(_folder("out", out), **common, console=output(json), **options)
    except (ImportError, BoundingError) as error:
        missing = (
            error if isinstance(error, ImportError) else error.__cause__
        )  # parts of the library name extras of their own
        name = missing.name if isinstance(missing, ImportError) else None
        if (name or "").split(".")[0] not in NEEDED:
            raise
        raise BoundingError(f"the demo needs {name}: pip install 'warp-bounding[sims]'") from error
    if json:
        print_json(result)
    return 0 if result["identical"] else 1


def _write_assets(folder: str, json: bool) -> int:
    """The meshes that documentation speaks of; if one is missing, nothing is written."""
    from sims.assets import MESHES, asset_mesh, obj

    quiet_warp()
    path = _folder("assets", folder)
    contents = {path / f"{name}.obj": obj(asset_mesh(name)) for name in MESHES}
    for file, content in contents.items():
        write_whole(file, content)
    files = [str(file) for file in contents]
    if json:
        print_json({"path": folder, "files": files})
    else:
        print(f"written: {', '.join(files)}")
    return 0


def _folder(option: str, out: str) -> Path:
    """The folder, made if there is none: before a run, not after it."""
    try:
        Path(out).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BoundingError(f"{option} must be a folder that can be written to, got {out}: {error.strerror}") from error
    return Path(out)


def _app():
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    app.command()(command)
    return app


def run(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with its status."""
    main(arguments, "sims", _app)


if __name__ == "__main__":
    run()
