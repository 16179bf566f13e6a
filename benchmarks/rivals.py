"""Speed of the most frequent calls, compared with rivals: `python benchmarks/rivals.py --out results/speed/rivals`.

Points around the bunny, dilated: networks, boxes in a tree, cells, against torch, Warp's tree over the very same boxes
(``wp.Bvh``) and Warp's query of the closest point on the mesh within the margin, which is exact. Rays: against Warp's
rays, its tree, and trimesh with Embree. Pairs: the cull of Newton's contact pass, one thread.

In each round every contestant of a group is timed once, in turn, after a pause; ratios are taken within a round, and
the median is reported. A network's work is its multiply-adds: how many, and what they would take at the rate of torch's
product of large float32 matrices on the same cores, in the same rounds; no floor, since a batch in lanes is faster than
that. Sines come on top. Warp's tree is built in every way that it offers: by constructor, and by boxes a leaf. Where
Embree is not installed (``pip install embreex``), its row is left out. A function has two rows. In the first about half
of the answers are *maybe*, in random order, so that no processor predicts its branches. In the second, *all maybe*,
every answer is *maybe*. Labels: exact answers of the 32-cell grid, as training asks for them.

``--device cuda:0`` asks the same of a GPU: torch there too, without rows of one core. Every time is one of a call that
is waited for.
"""

import argparse
import sys
import time
from collections.abc import Callable
from functools import partial
from importlib import metadata
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
import trimesh
import warp as wp
from shared import StoredRows, clock, race

import warp_bounding as wb
from sims.assets import asset_mesh, surface
from sims.threads import threads_of
from warp_bounding.bounders import METHODS
from warp_bounding.queries import QUERIES, oracle, sample
from warp_bounding.queries.domain import Domain
from warp_bounding.runtime.launch import cpu_threads
from warp_bounding.training.engine import TrainableNetwork

MARGIN, LENGTH = 0.012, 3.0  # object units; rays end outside of the object, as Embree's do
NETWORKS = ((24, 24), (50, 50))
LEAVES = (64, 256)
# how ``wp.Bvh`` builds a tree: constructor (none: its own choice, "sah" on a CPU, "lbvh" on a GPU) and boxes a leaf
TREES = ((None, 1), ("median", 1), ("cubql", 1), (None, 4), ("cubql", 4))
TREES_OF_GPU = (*TREES, ("sah", 1), ("sah", 4))
RIVALS = ("warp-lang", "torch", "trimesh", "embreex", "newton")  # their distributions
ONE_CORE = "one core"
CHUNKS = (2048, 4096, 8192, 16384, 32768, 65536)  # rows that torch is given at a time: the best of these
PAUSE = 0.02  # seconds; torch's threads wait busily after their work, and would be in the way of the next one
PRODUCT, PRODUCT_OF_GPU = 1024, 8192  # rows and columns of the matrices whose product is the rate of multiply-adds
Calls = dict[str, Callable]


class Sine(torch.nn.Module):
    """The paper's activation."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Elementwise sine."""
        return torch.sin(x)


def network(domain: Domain, activation: str, hidden: tuple[int, ...]):
    """A bounder with random weights of the usual size, and the same network as a torch module in object coordinates."""
    trained = TrainableNetwork(3, hidden, activation)
    trained.initialise(20.0 if activation == "sin" else 3.0, 3.0, torch.Generator().manual_seed(0))
    sizes = {"hidden": list(hidden), "activation": activation}
    bounder = METHODS["mlp"](domain, trained.tensors(), sizes, "cpu").freeze(0.0, None)
    modules = []
    for index, layer in enumerate(trained.layers):
        linear = torch.nn.Linear(layer.shape[1] - 1, layer.shape[0])
        with torch.no_grad():
            weight, bias = layer[:, :-1].clone(), layer[:, -1].clone()
            if index == 0:  # v = (x - center) * scale goes into the first layer: torch pays nothing for the map
                weight, bias = (
                    weight * torch.from_numpy(domain.scale),
                    bias - weight @ torch.from_numpy(domain.scale * domain.center),
                )
            linear.weight.copy_(weight)
            linear.bias.copy_(bias)
        modules += [linear, Sine() if activation == "sin" else torch.nn.ReLU()]
    return bounder, torch.nn.Sequential(*modules[:-1])


def in_kernel(bounder, points: wp.array, out: wp.array):
    """A launch of somebody's own kernel that calls the bounder's function; Warp runs it on one core."""

    @wp.kernel(enable_backward=False, module="unique")
    def ask(data: wb.Data, q: wp.array(dtype=wp.vec3), out: wp.array(dtype=wp.bool)):
        i = wp.tid()
        out[i] = wp.static(bounder.func)(data, q[i])

    return lambda: wp.launch(ask, dim=len(points), inputs=[bounder.data, points], outputs=[out], device=out.device)


def chunked(function, x: torch.Tensor, size: int):
    """``function`` over chunks of rows."""
    return lambda: [function(part) for part in x.split(size)]


@wp.kernel(enable_backward=False)
def _in_boxes(first: int, boxes: wp.uint64, x: wp.array(dtype=wp.vec3), out: wp.array(dtype=wp.bool)):
    i = first + wp.tid()
    query = wp.bvh_query_aabb(boxes, x[i], x[i])
    found = int(0)  # noqa: UP018, RUF046  a variable of the kernel
    out[i] = wp.bvh_query_next(query, found)


@wp.kernel(enable_backward=False)
def _ray_in_boxes(
    first: int, boxes: wp.uint64, length: float, rays: wp.array2d(dtype=float), out: wp.array(dtype=wp.bool)
):
    i = first + wp.tid()
    origin, way = wp.vec3(rays[i, 0], rays[i, 1], rays[i, 2]), wp.vec3(rays[i, 3], rays[i, 4], rays[i, 5])
    query = wp.bvh_query_ray(boxes, origin, way)
    found = int(0)  # noqa: UP018, RUF046  a variable of the kernel
    out[i] = wp.bvh_query_next(query, found, length)


@wp.kernel(enable_backward=False)
def _near_mesh(first: int, mesh: wp.uint64, margin: float, x: wp.array(dtype=wp.vec3), out: wp.array(dtype=wp.bool)):
    i = first + wp.tid()
    query = wp.mesh_query_point_sign_normal(mesh, x[i], margin)
    out[i] = query.result


@wp.kernel(enable_backward=False)
def _ray_on_mesh(
    first: int, mesh: wp.uint64, length: float, rays: wp.array2d(dtype=float), out: wp.array(dtype=wp.bool)
):
    i = first + wp.tid()
    origin, way = wp.vec3(rays[i, 0], rays[i, 1], rays[i, 2]), wp.vec3(rays[i, 3], rays[i, 4], rays[i, 5])
    out[i] = wp.mesh_query_ray_anyhit(mesh, origin, way, length)


def trees_of(bounder: wb.Bounder, label: str) -> dict[str, wp.Bvh]:
    """Warp's trees over the leaf boxes of a ``bvh``, one for each way to build it, by the names of their rows."""
    past = bounder.tensors["past"].astype(np.int64)
    leaf = past == np.arange(len(past)) + 1
    corners = [bounder.domain.base.to_object(bounder.tensors[name][leaf]) for name in ("low", "high")]
    corners = [wp.array(x.astype(np.float32), dtype=wp.vec3, device=bounder.device) for x in corners]
    trees, ways = {}, TREES if wp.get_device(bounder.device).is_cpu else TREES_OF_GPU
    for constructor, size in ways:
        built = f", {constructor or 'default'}, {size} a leaf" if (constructor, size) != (None, 1) else ""
        name = f"{label}, wp.Bvh of the same boxes{built}"
        trees[name] = wp.Bvh(*corners, constructor=constructor, leaf_size=size)
    return trees


def of_all_cores(kernel: wp.Kernel, count: int, inputs: list, out: wp.array) -> Callable:
    """A launch of a kernel on all cores of the device."""
    return lambda: wb.launch_on_cores(kernel, count, inputs, [out], out.device)


def rate(device: str) -> tuple[Callable, int]:
    """A product of matrices, and its multiply-adds."""
    size = PRODUCT if device == "cpu" else PRODUCT_OF_GPU
    a, b = torch.rand(size, size, device=device), torch.rand(size, size, device=device)
    return (lambda: torch.mm(a, b)), size**3


def waited_for(device: str) -> Callable:
    """A measure of ``race``: seconds of a call until the device has done all of it."""

    def measure(function: Callable) -> tuple[float, float]:
        wp.synchronize_device(device)
        return clock(lambda: (function(), wp.synchronize_device(device)))

    return measure


def points(count: int, device: str) -> tuple[Calls, dict[str, dict]]:
    """Contestants, and what is known of them."""
    mesh = asset_mesh("bunny").dilated(MARGIN)
    low, high = mesh.sample_lower, mesh.sample_upper
    x = np.random.default_rng(0).uniform(low, high, (count, 3)).astype(np.float32)
    array, tensor = wp.array(x, dtype=wp.vec3, device=device), torch.from_numpy(x).to(device)
    calls, known = {}, {}
    for widths in NETWORKS:
        label = "mlp " + "-".join(map(str, widths))
        function = f"{label}, function, {ONE_CORE}" if device == "cpu" else f"{label}, function"
        # random weights, which take as long as any; the domain holds all points, so that each is asked
        bounder, module = network(Domain.of(wb.shapes.Function(lambda x: x[:, 0] > 0, low, high)), "sin", widths)
        bounder, module = bounder.to(device), module.to(device)
        sizes = (3, *widths, 1)
        adds = sum(a * b for a, b in pairwise(sizes))
        sizes_of_chunks = CHUNKS if device == "cpu" else (count,)
        best = min(sizes_of_chunks, key=lambda size: np.median(race({"": chunked(module, tensor, size)}, 3)[""][:, 0]))
        out = wp.empty(count, dtype=wp.bool, device=device)
        calls[label] = bounder.prepare(array, out=out).launch
        calls[f"{label}, candidates"] = bounder.prepare(array, candidates=True).launch
        calls[function] = in_kernel(bounder, array, out)
        calls[f"{function}, all maybe"] = in_kernel(bounder.to(device).freeze(-1e6, None), array, out)
        calls[f"{label}, torch"] = chunked(module, tensor, best)
        for name in (label, function, f"{function}, all maybe", f"{label}, candidates"):
            known[name] = {"of": label, "multiply_adds": adds, "one_core": ONE_CORE in name}
        known[f"{label}, torch"] = {"of": label, "chunk": best}
    for leaves in LEAVES:
        bounder, out = (
            wb.fit(asset_mesh("bunny"), method="bvh", leaves=leaves, margin=MARGIN, device=device),
            wp.empty(count, dtype=wp.bool, device=device),
        )
        own, label = wp.empty(count, dtype=wp.bool, device=device), f"bvh {leaves}"
        calls[label], known[label] = bounder.prepare(array, out=out).launch, {"of": label}
        calls[label]()
        for name, tree in trees_of(bounder, label).items():
            calls[name] = of_all_cores(_in_boxes, count, [tree.id, array], own)
            calls[name]()
            assert (out.numpy() != own.numpy()).mean() < 1e-4, f"{name}: answers differ"  # by more than rounded corners
            known[name] = {"of": label, "tree": tree}
    for label, method, options in (("kdop", "kdop", {}), ("voxels 32", "voxels", {"resolution": 32})):
        bounder = wb.fit(asset_mesh("bunny"), method=method, margin=MARGIN, device=device, **options)
        calls[label], known[label] = bounder.prepare(array).launch, {"of": label}
    plain = asset_mesh("bunny")
    triangles, out = surface(plain.vertices, plain.faces, device), wp.empty(count, dtype=wp.bool, device=device)
    label = "wp.mesh_query_point, exact"
    calls[label], known[label] = (
        of_all_cores(_near_mesh, count, [triangles.id, MARGIN, array], out),
        {"of": "mlp 24-24", "tree": triangles},
    )
    return calls, known


def rays(count: int, device: str) -> tuple[Calls, dict[str, dict]]:
    """Contestants, and what is known of them."""
    mesh = asset_mesh("bunny")
    rng, low, high = np.random.default_rng(1), mesh.sample_lower, mesh.sample_upper
    way = rng.normal(size=(count, 3))
    x = np.concatenate([rng.uniform(low, high, (count, 3)), way / np.linalg.norm(way, axis=1)[:, None]], axis=1).astype(
        np.float32
    )
    array = wp.array(x, dtype=wp.float32, device=device)
    calls, known = {}, {}
    for label, method, options in (
        ("kdop", "kdop", {}),
        ("bvh 64", "bvh", {"leaves": 64}),
        ("bvh 256", "bvh", {"leaves": 256}),
    ):
        bounder, out = (
            wb.fit(mesh, "ray", method, length=LENGTH, resolution=32, device=device, progress=False, **options),
            wp.empty(count, dtype=wp.bool, device=device),
        )
        calls[label], known[label] = bounder.prepare(array, out=out).launch, {"of": label}
        if method == "bvh":
            own = wp.empty(count, dtype=wp.bool, device=device)
            for name, tree in trees_of(bounder, label).items():
                calls[name] = of_all_cores(_ray_in_boxes, count, [tree.id, LENGTH, array], own)
                known[name] = {"of": label, "tree": tree}
    triangles = surface(mesh.vertices, mesh.faces, device)
    label = "wp.mesh_query_ray_anyhit, exact"
    calls[label] = of_all_cores(
        _ray_on_mesh, count, [triangles.id, LENGTH, array], wp.empty(count, dtype=wp.bool, device=device)
    )
    known[label] = {"of": "bvh 64", "tree": triangles}
    embree = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).ray
    if device == "cpu" and "embree" in type(embree).__module__:
        label = f"trimesh with Embree, exact, {ONE_CORE}"
        calls[label], known[label] = (
            lambda: embree.intersects_any(x[:, :3], x[:, 3:]),
            {"of": "bvh 64", "one_core": True},
        )
    return calls, known


def pairs(device: str) -> tuple[Calls, dict[str, dict], int]:
    """Newton's contact pass without and with a cull, and the cull alone; one thread of a CPU."""
    import newton

    from sims.cloth.field import GAPS, Field
    from sims.cloth.scene import SHAPES, SPECS, dilated
    from sims.prefitted import fitted
    from warp_bounding.newton import Cull

    field, found = (
        Field(),
        fitted(
            {name: dilated(name) for name in SHAPES},
            {name: SPECS[name] for name in ("aabb", "mlp", "distance")},
            scenes="cloth-",
            device=device,
        ),
    )
    pipeline = newton.CollisionPipeline(field.model, soft_contact_gap=min(GAPS))
    state, contacts = field.model.state(), pipeline.contacts()

    def alone(call: Callable) -> Callable:
        def run():
            with threads_of(1):
                return call()

        return run

    calls, known = {}, {}
    for name, of_shape in found.items():
        cull = Cull(pipeline, {index: of_shape[shape] for index, shape in field.shapes.items()})
        calls[f"cull, {name}"] = alone(lambda cull=cull: cull.candidates(state))
        calls[f"pass with {name}"] = alone(lambda cull=cull: cull.collide(state, contacts))
        known |= {label: {"of": "cull, aabb", "one_core": True} for label in (f"cull, {name}", f"pass with {name}")}
    calls["Newton's pass"] = alone(lambda: pipeline.collide(state, contacts))
    known["Newton's pass"] = {"of": "cull, aabb", "one_core": True}
    return calls, known, len(pipeline.soft_rigid_contact_pairs)


def labels(count: int, device: str) -> tuple[Calls, dict[str, dict]]:
    """Exact answers of a grid, by kind of query."""
    grid = asset_mesh("bunny").to_grid(resolution=32)
    calls = {}
    for kind in QUERIES:
        calls[kind] = partial(oracle(kind, grid, device), sample(kind, grid, count, np.random.default_rng(0)))
    return calls, {kind: {"of": "point"} for kind in calls}


def measured(group: str, calls: Calls, known: dict[str, dict], count: int, rounds: int, device: str) -> list[dict]:
    """Rows of a group."""
    product, adds = rate(device)
    found = race(calls | {"": product}, rounds, waited_for(device), PAUSE)
    times = {name: of_all[:, 0] for name, of_all in found.items()}
    rows = []
    for name, about in known.items():
        row = {
            "group": group,
            "contestant": name,
            "of": about["of"],
            "count": count,
            "device": "cpu" if device == "cpu" else wp.get_device(device).name,
            "ns": 1e9 * float(np.median(times[name])) / count,
            "rivals": rivals(),
            "date": time.strftime("%Y-%m-%d", time.gmtime()),
        }
        row["times"] = float(np.median(times[name] / times[about["of"]]))
        if "multiply_adds" in about:
            cores = cpu_threads() if about["one_core"] else 1
            row["product_ns"] = 1e9 * float(np.median(times[""])) / adds * about["multiply_adds"] * cores
            row["multiply_adds"] = about["multiply_adds"]
        rows.append(row)
    return rows


def rivals() -> str:
    """Who is measured, with versions."""
    there = {each.name.lower(): each.version for each in metadata.distributions()}
    return ", ".join(f"{name} {there[name]}" for name in RIVALS if name in there)


def _digits(ns: float) -> str:
    return f"{ns:.2f}" if ns >= 1.0 else f"{ns:.3f}"


CONCLUSION = (
    "A batch of a network is several times as fast as torch and as the exact query of the mesh; our tree of "
    "boxes is faster than `wp.Bvh` over the same boxes.",
    "On a GPU a network is faster than torch. A small one takes half the time of the exact query within the "
    "margin, a larger one twice as long; trees of boxes and cells take less than either. Our tree is faster "
    "than `wp.Bvh` over the same boxes.",
)  # on a CPU, on a GPU


def page(kept: StoredRows, command: str) -> str:
    """The page, in Markdown."""
    devices = dict.fromkeys(row.get("device", "cpu") for row in kept.rows)
    others = dict.fromkeys(f"{row['rivals']}, measured on {row['date']}" for row in kept.rows if "rivals" in row)
    lines = [
        "# The most frequent queries, compared with what users have already",
        "",
        CONCLUSION["cpu" not in devices],
        "",
        f"`{command}`",
        "",
        f"{kept.about}. Rivals: {'; '.join(others)}. On {', '.join(devices)}.",
        "",
    ]
    lines += [line.strip() for line in __doc__.strip().splitlines()[2:]]
    for group in dict.fromkeys(row["group"] for row in kept.rows):
        rows = [row for row in kept.rows if row["group"] == group]
        lines += [
            "",
            f"## {group}",
            "",
            f"{rows[0]['count']:,} at a time.",
            "",
            "| | ns | times | of | multiply-adds | at the product's rate, ns |",
            "|---|---|---|---|---|---|",
        ]
        for row in rows:
            floor = f"{row['multiply_adds']:,} | {_digits(row['product_ns'])}" if "product_ns" in row else " | "
            lines.append(f"| {row['contestant']} | {_digits(row['ns'])} | {row['times']:.2f} | {row['of']} | {floor} |")
    return "\n".join(lines) + "\n"


def main() -> int:
    """Measure what is missing, then write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results/speed/rivals"))
    parser.add_argument("--count", type=int, default=1_000_000)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--groups", default="points,rays,labels,pairs of Newton", help="some of them")
    options = parser.parse_args()
    wp.config.quiet = True
    torch.set_num_threads(cpu_threads())
    torch.set_grad_enabled(False)
    kept = StoredRows(options.out, "rivals")
    groups = {
        "points": lambda: (*points(options.count, options.device), options.count),
        "rays": lambda: (*rays(options.count, options.device), options.count),
        "labels": lambda: (*labels(options.count, options.device), options.count),
    }
    if options.device == "cpu":
        groups["pairs of Newton"] = lambda: pairs(options.device)
    for group, made in groups.items():
        if group in options.groups.split(",") and not kept.have(group=group):
            for row in measured(group, *made(), options.rounds, options.device):
                kept.add(row)
    kept.write(page(kept, f"python benchmarks/rivals.py {' '.join(sys.argv[1:])}"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
