"""The bounders of a demo: closed forms fitted at once, networks from files that come with the demos, or fitted anew.

Files lie in ``sims/bounders``; ``python -m sims.refit`` makes them from the shapes inside installed packages. Each holds its certificate.
A file is used only for the very cells that it was proven for: the demo makes its grid and compares.
"""

from dataclasses import dataclass, field
from pathlib import Path

import warp_bounding as wb
from sims.report import UNPROVEN

__all__ = ["FOLDER", "FitSpec", "bounder_from", "bounders_of", "check_fit", "fit", "fitted", "owner", "stored"]

FOLDER = Path(__file__).parent / "bounders"
CLOSED = ("aabb", "obb", "sphere", "ellipsoid", "oriented-ellipsoid", "kdop", "bvh", "voxels")


@dataclass(frozen=True)
class FitSpec:
    """How a bounder of a demo is fitted.

    Attributes:
        method: As ``warp_bounding.fit`` takes it.
        query: Kind of query.
        budget: Seconds, where it is learned.
        options: More of what ``fit`` takes.
        kept: Stored like what is learned, although it is a closed form, since a fit takes seconds.
    """

    method: str
    query: str = "point"
    budget: float = 60.0
    options: dict = field(default_factory=dict)
    kept: bool = False

    @property
    def closed(self) -> bool:
        """Whether a fit takes no time to speak of, so that nothing is stored."""
        return self.method in CLOSED and not self.kept


def stored(scene: str, name: str, folder: Path = FOLDER) -> Path:
    """Where the bounder of this name of a scene lies."""
    return folder / f"{scene}-{name}.safetensors"


def fit(
    spec: FitSpec, grid: wb.IndicatorGrid, *, budget: float | None = None, seed: int = 0, device: str
) -> wb.Bounder:
    """Fit a bounder by its spec; a budget (seconds) replaces the spec's own."""
    seconds = spec.budget if budget is None else budget
    options = {"query": spec.query, "method": spec.method, "budget": seconds, "seed": seed, **spec.options}
    return wb.fit(grid, **options, margin=grid.margin, resolution=grid.resolution, device=device)


def check_fit(bounder: wb.Bounder, grid: wb.IndicatorGrid, spec: FitSpec, source: str) -> None:
    """Refuse a bounder that is not one of these cells.

    Raises:
        BounderError: Saying what was expected and what came, with both numbers.
    """
    if bounder.query_kind != spec.query or bounder.ndim != grid.ndim:
        got = f"{bounder.query_kind} queries in {bounder.ndim}D"
        raise wb.BounderError(f"{source}: expected a bounder of {spec.query} queries in {grid.ndim}D, got one of {got}")
    if bounder.method != spec.method:
        raise wb.BounderError(f"{source}: expected a bounder of method {spec.method}, got {bounder.method}")
    length = spec.options.get("length", 1.0)
    if spec.query == "ray" and bounder.domain.length != length:
        raise wb.BounderError(
            f"{source}: expected a bounder of rays of length {length:g}, got {bounder.domain.length:g}"
        )
    margin = bounder.info.get("margin") or 0.0
    if margin != grid.margin:
        why = "too small a margin" if margin < grid.margin else "another margin"
        raise wb.BounderError(f"{source}: {why}, expected {grid.margin:.6g}, got {margin:.6g}")
    if bounder.info.get("resolution") != grid.resolution:
        got = bounder.info.get("resolution")
        raise wb.BounderError(f"{source}: expected a bounder at resolution {grid.resolution}, got {got}")
    if bounder.info.get("indicator") != grid.digest:
        made, here = str(bounder.info.get("indicator"))[:12], grid.digest[:12]
        name = bounder.info.get("name")
        raise wb.BounderError(f"{source}: a bounder of another shape, {name}; expected cells {here}, got {made}")
    proven = bounder.certificate is not None and bounder.certificate.kind in ("proven", "statistical")
    if not proven and bounder.method not in UNPROVEN:
        raise wb.BounderError(f"{source}: expected a bounder with a certificate, got {bounder!r}")


def bounder_from(path: Path, grid: wb.IndicatorGrid, spec: FitSpec, *, device: str) -> wb.Bounder:
    """A bounder from a file, if it is one of these cells.

    Raises:
        BounderError: If it is not, or there is no such file.
    """
    path = Path(path)
    if not path.is_file():
        raise wb.BounderError(f"{path}: there is no bounder for this shape; --refit fits one")
    bounder = wb.load(path, device=device)
    check_fit(bounder, grid, spec, path.name)
    return bounder


def bounders_of(
    scene: str,
    grid: wb.IndicatorGrid,
    specs: dict[str, FitSpec],
    *,
    refit: bool = False,
    budget: float | None = None,
    out: Path | None = None,
    file: Path | None = None,
    seed: int = 0,
    device: str = "cpu",
    own: bool = False,
) -> dict[str, wb.Bounder]:
    """All bounders of one shape.

    Args:
        scene: Name under which its files lie.
        grid: The cells that it bounds.
        specs: By name; a name ``a+b`` whose parts are names before it is their cascade, and its spec is not used.
        refit: Fit the learned ones anew, into ``out``, rather than load them.
        budget: Seconds for each of them, then.
        out: Folder for what is fitted.
        file: A file for ``mlp``, instead of the stored one.
        seed: Of the fits.
        device: Warp device.
        own: The shape is a user's: its files lie in ``out``, and what is missing there is fitted.

    Raises:
        BounderError: For a file that is missing or of another shape, margin or resolution.
    """
    bounders: dict[str, wb.Bounder] = {}
    for name, spec in specs.items():
        parts = name.split("+")
        path = stored(scene, name, Path(out) if own else FOLDER)
        if len(parts) > 1 and all(part in bounders for part in parts):
            bounders[name] = wb.cascade(*(bounders[part] for part in parts))
        elif spec.closed:
            bounders[name] = fit(spec, grid, device=device)
        elif name == "mlp" and file is not None:
            bounders[name] = bounder_from(file, grid, spec, device=device)
        elif refit or (own and not path.is_file()):
            bounders[name] = fit(spec, grid, budget=budget, seed=seed, device=device)
            if out is not None:
                Path(out).mkdir(parents=True, exist_ok=True)
                bounders[name].save(stored(scene, name, Path(out)))
        else:
            bounders[name] = bounder_from(path, grid, spec, device=device)
    return bounders


def owner(file: Path, cells: dict[str, wb.IndicatorGrid]) -> str | None:
    """Whose bounder a file holds: the name of the very cells that it was fitted to, if they are among these.

    Raises:
        BounderError: If there is no such file.
    """
    if not Path(file).is_file():
        raise wb.BounderError(f"{file}: there is no such file")
    made = wb.load(file, device="cpu").info.get("indicator")
    return next((name for name, grid in cells.items() if grid.digest == made), None)


def fitted(
    cells: dict[str, wb.IndicatorGrid],
    specs: dict[str, FitSpec],
    *,
    scenes: str = "",
    file: Path | None = None,
    **options,
) -> dict[str, dict[str, wb.Bounder]]:
    """All bounders of some shapes, by name of the method, then of the shape.

    Args:
        cells: Of the shapes, by name.
        specs: By name of the method.
        scenes: What the names of all shapes' files begin with.
        file: For ``mlp`` of the shape that it was made of; the first shape refuses one that is of none of them.
        options: More of what ``bounders_of`` takes.

    Raises:
        BounderError: For a bounder that is missing or does not fit.
    """
    whose = None if file is None else owner(file, cells) or next(iter(cells))
    found = {
        name: bounders_of(scenes + name, grid, specs, file=file if name == whose else None, **options)
        for name, grid in cells.items()
    }
    return {method: {name: found[name][method] for name in cells} for method in specs}
