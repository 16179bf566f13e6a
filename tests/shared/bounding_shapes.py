"""Small shapes of every kind, points where bounders fail first, and one way to make a bounder of any method."""

from functools import cache

import numpy as np
import pytest

import warp_bounding as wb
from warp_bounding.bounders import METHODS
from warp_bounding.bounders.bounder import taken
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.networks import tensor_cores
from warp_bounding.queries.domain import Domain
from warp_bounding.shapes import Grid

HIDDEN = (8,)  # of every fitted network: each new size costs a compilation
DEEP = (6, 5)  # of one with two hidden layers
# of random weights, where sizes matter: below, on and above multiples of the lanes; activation
NETWORKS = [(hidden, name) for hidden in ((25, 25), (13, 30, 5)) for name in ("sin", "relu")]


def _blob(shape, seed, share=0.35, **options) -> Grid:
    occupancy = np.random.default_rng(seed).random(shape) < share
    occupancy.flat[:2] = True, False
    return Grid(occupancy, **options)


def _c() -> Grid:
    occupancy = np.zeros((12, 12), bool)
    occupancy[2:10, 2:10] = True
    occupancy[4:8, 4:] = False
    return Grid(occupancy)


def _star() -> Grid:
    t = np.abs(np.stack(np.meshgrid(*[np.linspace(-1, 1, 11)] * 3, indexing="ij")))
    return Grid(np.sqrt(t).sum(axis=0) < 1.3)


def _animated() -> Grid:
    occupancy = np.zeros((5, 7, 6, 8), bool)
    for step in range(5):
        occupancy[step, 1 + step // 2 : 3 + step // 2, 1:4, step : step + 3] = True
    return Grid(occupancy, time=True)


def _half() -> Grid:
    occupancy = np.zeros((10, 4, 4), bool)
    occupancy[:5] = True  # reaches the border: most of it touches no empty cell
    return Grid(occupancy)


def _single() -> Grid:
    occupancy = np.zeros((5, 1, 3), bool)  # an axis of one cell
    occupancy[2, 0, 1] = True
    return Grid(occupancy)


SHAPES = {
    "line": lambda: Grid(np.array([0, 1, 1, 0, 0, 1, 0, 0, 0], bool)),
    "c": _c,
    "blob": lambda: _blob((8, 9, 7), 1),
    "star": _star,
    "half": _half,
    "single": _single,
    "anisotropic": lambda: _blob((2, 33, 5), 2, cells_per_unit=[0.5, 1024.0, 3.0], offset=[0.0, -7.0, 0.5]),
    "mesh": lambda: _blob((9, 8, 7), 3, cells_per_unit=[39.53125] * 3, offset=[-390.0, 0.0, -22.0]),
    "animated": _animated,
    "five": lambda: _blob((4, 3, 4, 2, 3), 4),
}


@cache
def shape(name: str) -> Grid:
    return SHAPES[name]()


def fitted(method: str, name: str) -> wb.Bounder:
    """A proven bounder on the CPU, through the public door; never change it."""
    skip_unless_supported(method, name)
    return _fitted(method, name)


@cache
def _fitted(method: str, name: str) -> wb.Bounder:
    return fitted_query(name, method, "point", 1.0)


def report_of(method: str, query: str = "point", **options) -> dict:
    """Of these options of ``fit`` those that the method, or a part of a cascade, takes for the query."""
    known = {*taken((METHODS[part] for part in method.split("+")), query)}
    known |= {"length"} if query == "ray" else set()
    return {name: value for name, value in options.items() if name in known}


@cache
def fitted_query(name: str, method: str, query: str, length: float, steps: int = 3) -> wb.Bounder:
    """A bounder of any kind of query, of few steps, on the CPU; never change it."""
    told = report_of(method, query, hidden=HIDDEN, steps=steps, length=length)
    return wb.fit(shape(name), query, method, device="cpu", **told)


def few(name="blob", method="mlp", query="point", **options):
    """A fit of few steps; what a test does not name itself is told to the methods that take it."""
    known = isinstance(method, str) and {*method.split("+")} <= {*wb.METHODS}
    small = report_of(method, query, hidden=HIDDEN, steps=3) if known else {}
    return wb.fit(shape(name), query, method, **({"device": "cpu"} | small | options))


def random_layers(sizes, rng, gain=2.0, first=None) -> list[tuple[np.ndarray, np.ndarray]]:
    """Weights and biases, float32; ``gain`` is that of a layer, which is another one in the first."""
    gains = [gain if first is None else first] + [gain] * len(sizes)
    return [
        ((rng.normal(size=(h, k)) * (g / np.sqrt(k))).astype(np.float32), rng.normal(size=h).astype(np.float32))
        for k, h, g in zip(sizes, sizes[1:], gains, strict=False)
    ]


def random_mlp(grid, hidden=HIDDEN, activation="sin", seed=0, device="cpu", gain=4.0, domain=None) -> Mlp:
    """A network of random weights. It is hard to bound, and nothing is proven of it."""
    rng, domain, tensors = np.random.default_rng(seed), domain or Domain.of(grid), {}
    for index, (weight, bias) in enumerate(random_layers((domain.ndim, *hidden, 1), rng, 1.5, gain)):
        tensors |= {f"layers.{index}.weight": weight, f"layers.{index}.bias": bias}
    return Mlp(domain, tensors, {"hidden": list(hidden), "activation": activation}, device)


@cache
def reader(domain, coordinate: int, device: str) -> Mlp:
    """``f = v_k`` to the last bit: 1 relu(v_k) - 1 relu(-v_k), all else 0."""
    first, last = np.zeros((2, domain.ndim)), np.zeros((1, 2))
    first[:, coordinate] = last[0] = 1, -1
    parts = {"0.weight": first, "0.bias": np.zeros(2), "1.weight": last, "1.bias": np.zeros(1)}
    sizes = {"hidden": [2], "activation": "relu"}
    return Mlp(domain, {f"layers.{name}": tensor.astype(np.float32) for name, tensor in parts.items()}, sizes, device)


CONSERVATIVE = tuple(name for name, kind in METHODS.items() if kind.conservative)


def crossed(methods, names, kinds=None, few=("aabb", "mlp")) -> list:
    """Each method with each shape, but with ``--slow`` only, since they have kernels of their own: in one dimension and
    in five all but a few; methods of cells, whose kernels depend on how many there are, but for a few shapes; in two
    dimensions and in four all but these ``kinds``, if they are reported.
    """
    rare = [(m, n) for n in ("line", "five") for m in methods if m not in few]
    rare += [(m, n) for m in ("voxels", "relu-field") for n in ("star", "half", "single", "anisotropic")]
    rare += [(m, n) for n in ("c", "animated") for m in methods if kinds and m not in kinds]
    pairs = [(method, name) for name in names for method in methods]
    return [pytest.param(*p, marks=pytest.mark.slow) if p in rare else p for p in pairs]


def skip_unless_supported(method: str, name: str) -> None:
    """Skip the test where a method does not bound points of this shape."""
    if not METHODS[method].supports("point", shape(name).ndim):
        pytest.skip(f"{method} does not bound {shape(name).ndim}D objects")


def random_bounder(method: str, name: str, device: str = "cpu"):
    """Like ``fitted``, but a network keeps its random weights."""
    skip_unless_supported(method, name)
    grid, kind = shape(name), METHODS[method]
    if not issubclass(kind, Mlp):
        return kind.fit(grid, Domain.of(grid), device=device)
    network = random_mlp(grid, device=device)
    return kind(network.domain, network.tensors, network.sizes, device)


def rounding_of_answers(bounder) -> float:
    """How far f may be from the threshold where rounding decides what ``query`` answers: farther on tensor cores."""
    if getattr(bounder, "tensor_numbers", None) is None:
        return bounder.rounding_bound()
    return 2 * tensor_cores.rounding(bounder.network)


def device_coordinates(bounder, x: np.ndarray) -> np.ndarray:
    """``v`` as every device computes it from float32 points: a difference, then a product."""
    d = bounder.domain
    return ((x - d.center) * d.scale).astype(np.float64)


def domain_points(grid: Grid, count: int, rng: np.random.Generator) -> np.ndarray:
    """Uniform float32 points of the domain, and a little around it."""
    size = grid.upper - grid.lower
    return (grid.lower - 0.02 * size + rng.random((count, grid.ndim)) * 1.04 * size).astype(np.float32)


def object_points(grid: Grid, rng: np.random.Generator, count: int = 4000) -> np.ndarray:
    """Points of the object, float32, all of them: random ones, and corners, faces and centres nudged both ways."""
    cells = grid.occupied[rng.integers(len(grid.occupied), size=count)]
    kind = rng.integers(3, size=count)[:, None]
    offset = rng.uniform(-0.5, 0.5, (count, grid.ndim))
    snapped = np.where(rng.random(offset.shape) < 0.6, np.copysign(0.5, offset), offset)
    offset = np.where(kind == 0, offset, np.where(kind == 1, snapped, rng.choice([-0.5, 0.0, 0.5], offset.shape)))
    x = grid.position(cells + offset).astype(np.float32)
    near = [np.nextafter(x, np.float32(s * np.inf)) for s in (-1, 1)]
    mixed = np.where(rng.random(x.shape) < 0.5, *near)
    x = np.concatenate([x, *near, mixed, grid.position(grid.occupied).astype(np.float32)])
    return x[grid.contains(x)]


def denying(bounder, points):
    """The bounder with its threshold raised above f at all of these points of the object."""
    raised = bounder.to(str(bounder.device))
    values = raised.values(np.asarray(points, np.float32)).numpy()
    return raised.freeze(float(np.nextafter(values.max(), np.float32(np.inf))), None)


def reloaded(bounder: wb.Bounder, folder, device: str = "cpu") -> wb.Bounder:
    """From its file, with its certificate."""
    bounder.save(folder / "b.safetensors")
    again = wb.load(folder / "b.safetensors", device=device)
    assert again.certificate == bounder.certificate
    return again
