"""Fits the bounders that the demos load, from the shapes inside installed packages, into ``sims/bounders``.

    python -m sims.refit                     # all: about an hour on 2 cores
    python -m sims.refit rain rooms-mlp      # all of a scene, or one file

A file that fits the scene's shape is kept unless it is named in full; so a run that was stopped goes on where it
stopped.
"""

import sys
import time
from importlib import import_module

from rich.console import Console

import warp_bounding as wb
from sims import DEMOS
from sims.assets import Shape
from sims.prefitted import FOLDER, FitSpec, bounder_from, fit, stored

__all__ = ["main", "plan"]


def plan(names: list[str]) -> list[tuple[str, str, FitSpec, Shape]]:
    """Scene, name, spec and shape of every file that is requested.

    Args:
        names: Scenes, or ``scene-name``; all if empty.

    Raises:
        BoundingError: For a name that there is not.
    """
    files = []
    for demo in DEMOS:
        module = import_module(f"sims.{demo}")
        for scene, shape in module.shapes().items():
            specs = getattr(module, "SCENE_SPECS", {}).get(scene, module.SPECS)
            learned = {n: r for n, r in specs.items() if not r.closed and "+" not in n}
            files += [(scene, name, spec, shape) for name, spec in learned.items()]
    wanted = [f for f in files if not names or f[0] in names or f"{f[0]}-{f[1]}" in names]
    known = {f[0] for f in files} | {f"{f[0]}-{f[1]}" for f in files}
    if unknown := sorted(set(names) - known):
        raise wb.BoundingError(f"expected scenes or files of {', '.join(sorted(known))}, got {', '.join(unknown)}")
    return wanted


def main(names: list[str]) -> None:
    """Fit what is asked for, and say of each what it is."""
    console = Console(highlight=False, soft_wrap=True)
    FOLDER.mkdir(exist_ok=True)
    for scene, name, spec, shape in plan(names):
        path = stored(scene, name)
        if f"{scene}-{name}" not in names and _fits(path, shape, spec):
            console.print(f"{path.name}: kept")
            continue
        begun = time.perf_counter()
        bounder = fit(spec, shape, device="cpu")
        bounder.save(path)
        rates = wb.evaluate(bounder, shape)
        kind = bounder.certificate.kind if bounder.certificate else "no certificate"
        seconds, size = time.perf_counter() - begun, path.stat().st_size
        console.print(f"{path.name}: {kind}, FP {rates.fp_rate:.2f} %, FN {rates.fn}, {size:,} bytes, {seconds:.0f} s")
    for demo in DEMOS:
        module = import_module(f"sims.{demo}")
        if hasattr(module, "hold") and (not names or set(module.shapes()) & set(names)):
            for scene, balls in module.hold(FOLDER / "pairs").items():
                console.print(f"{scene}: {balls!r}")


def _fits(path, shape: Shape, spec: FitSpec) -> bool:
    try:
        bounder = bounder_from(path, shape, spec, device="cpu")
    except wb.BoundingError:
        return False
    hidden = spec.options.get("hidden")
    return hidden is None or list(bounder.sizes.get("hidden", hidden)) == list(hidden)


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except wb.BoundingError as error:
        sys.exit(f"refit: {error}")
