"""The bounders of a demo: closed forms fitted at once, networks from files that come with the demos, or fitted anew.

Files lie in ``sims/bounders``; ``python -m sims.refit`` makes them from the shapes inside installed packages. Each
holds its certificate. What a scene has is the shape itself: a mesh, a motion or a grid. A spec with a resolution bounds
cells of it, as methods that are made of cells, and rays, must; the others bound the shape. A file is used only for the
very shape, or the very cells, that it was proven for.
"""

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import warp_bounding as wb
from sims.assets import Shape
from sims.report import UNPROVEN

__all__ = [
    "FOLDER",
    "FitSpec",
    "bounded",
    "bounder_from",
    "bounders_of",
    "check_fit",
    "fit",
    "fitted",
    "owner",
    "stored",
]

FOLDER = Path(__file__).parent / "bounders"
CLOSED = ("aabb", "obb", "sphere", "ellipsoid", "oriented-ellipsoid", "kdop", "bvh", "voxels", "distance-grid")


@dataclass(frozen=True)
class FitSpec:
    """How a bounder of a demo is fitted.

    Attributes:
        method: As ``warp_bounding.fit`` takes it.
        query: Kind of query.
        budget: Seconds, where it is learned.
        options: More of what ``fit`` takes.
        resolution: Cells along the longest side, where cells of a mesh or a motion are bounded; ``None``: the shape
            itself.
        kept: Stored like what is learned, although it is a closed form, since a fit takes seconds.
    """

    method: str
    query: str = "point"
    budget: float = 60.0
    options: dict = field(default_factory=dict)
    resolution: int | None = None
    kept: bool = False

    @property
    def closed(self) -> bool:
        """Whether a fit takes no time to speak of, so that nothing is stored."""
        return self.method in CLOSED and not self.kept


def stored(scene: str, name: str, folder: Path = FOLDER) -> Path:
    """Where the bounder of this name of a scene lies."""
    return folder / f"{scene}-{name}.safetensors"


@lru_cache(maxsize=16)
def _cells(shape: Shape, resolution: int) -> wb.shapes.Grid:
    """Cells of a shape that knows its margin; several bounders are made of the same."""
    return shape.to_grid(resolution=resolution)


def bounded(spec: FitSpec, shape: Shape) -> Shape:
    """What a bounder of this spec bounds: the shape itself, or cells of it; a grid is its own cells."""
    if spec.resolution is None or isinstance(shape, wb.shapes.Grid):
        return shape
    return _cells(shape, spec.resolution)


def fit(spec: FitSpec, shape: Shape, *, budget: float | None = None, seed: int = 0, device: str) -> wb.Bounder:
    """Fit a bounder to a shape, which knows its margin, by its spec; a budget (seconds) replaces the spec's own."""
    seconds, own = spec.budget if budget is None else budget, bounded(spec, shape)
    options = {"query": spec.query, "method": spec.method, "budget": seconds, "seed": seed, **spec.options}
    return wb.fit(own, **options, margin=own.margin, resolution=own.resolution, device=device)


def check_fit(bounder: wb.Bounder, shape: Shape, spec: FitSpec, source: str) -> None:
    """Refuse a bounder that is not one of this shape, or of the cells of it that its spec asks for.

    Raises:
        BounderError: Saying what was expected and what came, with both numbers.
    """
    if bounder.query_kind != spec.query or bounder.ndim != shape.ndim:
        got = f"{bounder.query_kind} queries in {bounder.ndim}D"
        expected = f"{spec.query} queries in {shape.ndim}D"
        raise wb.BounderError(f"{source}: expected a bounder of {expected}, got one of {got}")
    if bounder.method != spec.method:
        raise wb.BounderError(f"{source}: expected a bounder of method {spec.method}, got {bounder.method}")
    length = spec.options.get("length", 1.0)
    if spec.query == "ray" and bounder.domain.length != length:
        raise wb.BounderError(
            f"{source}: expected a bounder of rays of length {length:g}, got {bounder.domain.length:g}"
        )
    margin = bounder.info.get("margin") or 0.0
    if margin != shape.margin:
        why = "too small a margin" if margin < shape.margin else "another margin"
        raise wb.BounderError(f"{source}: {why}, expected {shape.margin:.6g}, got {margin:.6g}")
    own, side = bounded(spec, shape), spec.options.get("side", "outside")
    if bounder.domain.unbounded != (side == "inside"):
        raise wb.BounderError(f"{source}: expected a bounder from the {side}, got one from the other side")
    if bounder.info.get("resolution") != own.resolution:
        expected, got = (
            "the shape itself" if cells is None else f"its cells at resolution {cells}"
            for cells in (own.resolution, bounder.info.get("resolution"))
        )
        raise wb.BounderError(f"{source}: expected a bounder of {expected}, got one of {got}")
    digest = wb.shapes.Complement(own).digest if side == "inside" else own.digest
    if bounder.info.get("indicator") != digest:
        made, here = str(bounder.info.get("indicator"))[:12], digest[:12]
        name = bounder.info.get("name")
        raise wb.BounderError(f"{source}: a bounder of another shape, {name}; expected {here}, got {made}")
    proven = bounder.certificate is not None and bounder.certificate.kind in ("proven", "statistical")
    if not proven and bounder.method not in UNPROVEN:
        raise wb.BounderError(f"{source}: expected a bounder with a certificate, got {bounder!r}")


def bounder_from(path: Path, shape: Shape, spec: FitSpec, *, device: str) -> wb.Bounder:
    """A bounder from a file, if it is one of this shape.

    Raises:
        BounderError: If it is not, or there is no such file.
    """
    path = Path(path)
    if not path.is_file():
        raise wb.BounderError(f"{path}: there is no bounder for this shape; --refit fits one")
    bounder = wb.load(path, device=device)
    check_fit(bounder, shape, spec, path.name)
    return bounder


def bounders_of(
    scene: str,
    shape: Shape,
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
        shape: What is bounded, margin included.
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
            bounders[name] = fit(spec, shape, device=device)
        elif name == "mlp" and file is not None:
            bounders[name] = bounder_from(file, shape, spec, device=device)
        elif refit or (own and not path.is_file()):
            bounders[name] = fit(spec, shape, budget=budget, seed=seed, device=device)
            if out is not None:
                Path(out).mkdir(parents=True, exist_ok=True)
                bounders[name].save(stored(scene, name, Path(out)))
        else:
            bounders[name] = bounder_from(path, shape, spec, device=device)
    return bounders


def owner(file: Path, shapes: dict[str, Shape], spec: FitSpec) -> str | None:
    """Whose bounder a file holds: the name of the shape that it, or its cells, was fitted to, if among these.

    Args:
        file: Of a bounder.
        shapes: By name.
        spec: Of the bounder: which cells of the shapes are bounded, if any.

    Raises:
        BounderError: If there is no such file.
    """
    if not Path(file).is_file():
        raise wb.BounderError(f"{file}: no such file")
    made = wb.load(file, device="cpu").info.get("indicator")
    return next((name for name, shape in shapes.items() if bounded(spec, shape).digest == made), None)


def fitted(
    shapes: dict[str, Shape],
    specs: dict[str, FitSpec],
    *,
    scenes: str = "",
    file: Path | None = None,
    **options,
) -> dict[str, dict[str, wb.Bounder]]:
    """All bounders of some shapes, by name of the method, then of the shape.

    Args:
        shapes: What is bounded, by name.
        specs: By name of the method.
        scenes: What the names of all shapes' files begin with.
        file: For ``mlp`` of the shape that it was made of; the first shape refuses one that is of none of them.
        options: More of what ``bounders_of`` takes.

    Raises:
        BounderError: For a bounder that is missing or does not fit.
    """
    whose = None
    if file is not None:
        whose = owner(file, shapes, specs.get("mlp", FitSpec("mlp"))) or next(iter(shapes))
    found = {
        name: bounders_of(scenes + name, shape, specs, file=file if name == whose else None, **options)
        for name, shape in shapes.items()
    }
    return {method: {name: found[name][method] for name in shapes} for method in specs}
