"""Who is queried, and for how long.

Networks on tensor cores and in float32, boxes, half-spaces, Warp's exact queries.
"""

import time
from functools import partial
from pathlib import Path

import numpy as np
import warp as wp

import warp_bounding as wb
from warp_bounding.kernels.functions import batch_kernel
from warp_bounding.networks import tensor_cores

MARGIN = 0.012
NETWORKS = ((24, 24), (32, 32), (50, 50))


def ns(call, count: int, repeats: int = 9, calls: int = 10) -> list[float]:
    """Nanoseconds a query: the median and the least of some means of calls in a row, by the device's clock."""
    for _ in range(3):
        call()
    found = []
    if not wp.is_cuda_available():  # to try the script on a CPU
        begin = time.perf_counter()
        call()
        return [(time.perf_counter() - begin) * 1e9 / count] * 2
    for _ in range(repeats):
        begin, end = wp.Event(enable_timing=True), wp.Event(enable_timing=True)
        wp.record_event(begin)
        for _ in range(calls):
            call()
        wp.record_event(end)
        found.append(wp.get_event_elapsed_time(begin, end) * 1e6 / calls / count)
    return [float(np.median(found)), float(min(found))]


def prepare(folder: Path) -> None:
    """Bounders and a mesh, so that the machine with the card needs no reader of meshes and fits nothing."""
    sys_path()
    from rivals import network

    from sims.assets import asset_mesh
    from sims.cloth.scene import SHAPES, shape
    from warp_bounding.queries.domain import Domain

    folder.mkdir(parents=True, exist_ok=True)
    bunny = asset_mesh("bunny")
    np.savez(
        folder / "bunny.npz",
        vertices=np.asarray(bunny.vertices, np.float32),
        faces=np.asarray(bunny.faces, np.int32),
        low=bunny.sample_lower,
        high=bunny.sample_upper,
    )
    mesh = bunny.dilated(MARGIN)
    low, high = mesh.sample_lower, mesh.sample_upper
    np.savez(folder / "frame.npz", low=low, high=high)
    for widths in NETWORKS:
        bounder, _ = network(Domain.of(wb.shapes.Function(lambda x: x[:, 0] > 0, low, high)), "sin", widths)
        bounder.save(folder / f"points-{widths[0]}.safetensors")
    for method, options in (("bvh", {"leaves": 64}), ("kdop", {})):
        wb.fit(bunny, method=method, margin=MARGIN, **options).save(folder / f"points-{method}.safetensors")
    wb.pairs.Balls.of(bunny, 256).save(folder / "bunny-balls.safetensors")
    for name in SHAPES:
        np.savez(folder / f"newton-{name}.npz", vertices=shape(name).vertices, faces=shape(name).faces)
    for hidden in ((24, 24), (50, 50)):
        options = {"hidden": hidden, "progress": False}
        wb.fit(bunny, "distance", "mlp", budget=60, **options).save(folder / f"bunny-distance-{hidden[0]}.safetensors")
        wb.fit(bunny, "point", "mlp", margin=MARGIN, budget=90, **options).save(
            folder / f"bunny-{hidden[0]}.safetensors"
        )
    for nodes in (32, 64):
        grid = wb.fit(bunny, "distance", "distance-grid", nodes=nodes, progress=False)
        grid.save(folder / f"bunny-distance-grid-{nodes}.safetensors")
    wb.fit(bunny, "ray", "bvh", length=3.0, resolution=32, leaves=64).save(folder / "rays-bvh.safetensors")


def sys_path() -> None:
    """The folder of all benchmarks."""
    import sys

    sys.path.insert(0, str(Path(__file__).parent.parent))


def loaded(arguments, name: str):
    """A prepared bounder on the card."""
    return wb.load(arguments.data / f"{name}.safetensors", device=arguments.device)


def launch_of(bounder, queries: wp.array, count: int, out: wp.array, cores: bool, values: bool = False):
    """A launch on tensor cores, or in float32."""
    source, data = bounder.source, bounder.data
    if not cores:
        inputs = [queries, count, 0, data.parameters, data.words, data.parameters]
        kernel, threads = batch_kernel(source, False, values), source.threads(count)
    else:
        inputs = [queries, count, 0, data.parameters, data.words, data.parameters, bounder.tensor_numbers]
        kernel, threads = batch_kernel(source, False, values, tensor_cores.text(source)), tensor_cores.threads(count)
    block = tensor_cores.BLOCK if cores or source.several > 1 else 256
    return wp.launch(kernel, threads, inputs, [out], device=bounder.device, block_dim=block, record_cmd=True).launch


def uniform(low, high, count: int, device: str, seed: int = 0) -> wp.array:
    """Flat float32 points on the card."""
    x = np.random.default_rng(seed).uniform(low, high, (count, len(low))).astype(np.float32)
    return wp.array(x.reshape(-1), dtype=wp.float32, device=device)


def rays_of(arguments, count: int) -> np.ndarray:
    """Rays through the bunny's box."""
    frame, rng = np.load(arguments.data / "bunny.npz"), np.random.default_rng(1)
    way = rng.normal(size=(count, 3))
    way /= np.linalg.norm(way, axis=1)[:, None]
    return np.concatenate([rng.uniform(frame["low"], frame["high"], (count, 3)), way], axis=1).astype(np.float32)


def answers(arguments) -> dict:
    """Values on the card against the network in float64: the largest error, and its bound."""
    found, count = {}, 200_003
    frame = np.load(arguments.data / "frame.npz")
    for name in [f"points-{w[0]}" for w in NETWORKS]:
        bounder = loaded(arguments, name)
        x, values = uniform(frame["low"], frame["high"], count, arguments.device, 3), {}
        for cores in (False, True):
            out = wp.full(count, 7e7, dtype=wp.float32, device=arguments.device)
            launch_of(bounder, x, count, out, cores, values=True)()
            values[cores] = out.numpy().astype(np.float64)
        inside = np.isfinite(values[False])
        v = (x.numpy().reshape(-1, 3) - bounder.domain.center) * bounder.domain.scale
        exact = bounder.network(v[inside])
        row = {
            "asked": int(inside.sum()),
            "same": bool((np.isfinite(values[True]) == inside).all()),
            "float32": bounder.network.rounding,
            "bound": tensor_cores.rounding(bounder.network),
            "difference": float(np.abs(values[True][inside] - values[False][inside]).max()),
            "error": float(np.abs(values[True][inside] - exact).max()),
            "error32": float(np.abs(values[False][inside] - exact).max()),
        }
        out = wp.zeros(count, dtype=wp.bool, device=arguments.device)
        launch_of(bounder, x, count, out, True)()
        numbers = bounder.tensor_numbers.numpy()
        row["answers"] = bool((out.numpy() == ~(values[True] < numbers[0])).all())
        found[name] = row
    return found


def points(arguments) -> dict:
    """Ns a point."""
    frame, count = np.load(arguments.data / "frame.npz"), arguments.count
    x, out, found = (
        uniform(frame["low"], frame["high"], count, arguments.device),
        wp.zeros(count, dtype=wp.bool, device=arguments.device),
        {},
    )
    for widths in NETWORKS:
        bounder = loaded(arguments, f"points-{widths[0]}")
        for name, cores in (("float32", False), ("tensor", True)):
            found[f"{widths[0]} {name}"] = ns(launch_of(bounder, x, count, out, cores), count)
    for method in ("bvh", "kdop"):
        bounder = loaded(arguments, f"points-{method}")
        found[method] = ns(launch_of(bounder, x, count, out, False), count)
    copied = wp.zeros_like(x)
    found["copy of the points"] = ns(lambda: wp.copy(copied, x), count)
    return found


@wp.kernel(enable_backward=False)
def _within(mesh: wp.uint64, margin: float, x: wp.array(dtype=wp.vec3), out: wp.array(dtype=wp.bool)):
    i = wp.tid()
    query = wp.mesh_query_point_sign_normal(mesh, x[i], margin)
    out[i] = query.result


@wp.kernel(enable_backward=False)
def _distance(mesh: wp.uint64, most: float, x: wp.array(dtype=wp.vec3), out: wp.array(dtype=float)):
    i = wp.tid()
    query = wp.mesh_query_point_no_sign(mesh, x[i], most)
    out[i] = most
    if query.result:
        out[i] = wp.length(x[i] - wp.mesh_eval_position(mesh, query.face, query.u, query.v))


@wp.kernel(enable_backward=False)
def _ray(mesh: wp.uint64, length: float, rays: wp.array(dtype=float), out: wp.array(dtype=wp.bool)):
    i = 6 * wp.tid()
    origin, way = wp.vec3(rays[i], rays[i + 1], rays[i + 2]), wp.vec3(rays[i + 3], rays[i + 4], rays[i + 5])
    out[wp.tid()] = wp.mesh_query_ray_anyhit(mesh, origin, way, length)


def _mesh(arguments) -> wp.Mesh:
    frame = np.load(arguments.data / "bunny.npz")
    vertices = wp.array(frame["vertices"], dtype=wp.vec3, device=arguments.device)
    return wp.Mesh(
        points=vertices, indices=wp.array(frame["faces"].reshape(-1), dtype=wp.int32, device=arguments.device)
    )


def distances(arguments) -> dict:
    """Ns a point: exact closest points without a limit and within one, against a network's lower bound."""
    frame, count = np.load(arguments.data / "frame.npz"), arguments.count
    mesh, device = _mesh(arguments), arguments.device
    flat = uniform(frame["low"], frame["high"], count, device)
    x = wp.array(ptr=flat.ptr, dtype=wp.vec3, shape=(count,), device=device)
    mask, d = wp.zeros(count, dtype=wp.bool, device=device), wp.zeros(count, dtype=float, device=device)
    found, held = {}, {}
    for name, kernel, most, out in (
        ("within margin", _within, MARGIN, mask),
        ("distance, no limit", _distance, 1e6, d),
        ("distance within 0.1", _distance, 0.1, d),
    ):
        call = wp.launch(kernel, count, [mesh.id, most, x], [out], device=device, record_cmd=True).launch
        found[f"wp.mesh_query_point, {name}"] = ns(call, count, 3, 2)
    radius = wp.zeros(1, dtype=float, device=device)
    for widths in (24, 50):
        bounder = loaded(arguments, f"bunny-distance-{widths}")
        data, source = bounder.data, bounder.source
        inputs = [flat, count, 0, data.parameters, data.words, radius]
        for name, kernel, threads, more in (
            ("float32", batch_kernel(source, False, True), source.threads(count), []),
            (
                "tensor",
                batch_kernel(source, False, True, bounder.tensor_text),
                tensor_cores.threads(count),
                [bounder.tensor_numbers],
            ),
        ):
            call = wp.launch(
                kernel, threads, [*inputs, *more], [d], device=device, block_dim=128, record_cmd=True
            ).launch
            found[f"{widths} {name}"] = ns(call, count, 5)
            held[name] = d.numpy()
        found[f"{widths}, largest difference of both"] = float(np.abs(held["float32"] - held["tensor"]).max())
        rays = wp.array(rays_of(arguments, count), dtype=wp.float32, device=device)
        for name, numbers in (("float32", None), ("tensor", bounder.tensor_numbers)):
            chosen = bounder.to(device)
            if numbers is None:
                chosen._held = chosen.data, None
            maybe = []
            found[f"{widths} {name}, rays of length 3, 32 steps"] = ns(
                lambda b=chosen, found=maybe, rays=rays: found.append(b.rays(rays, length=3.0)[0]), count, 3, 2
            )
            found[f"{widths} {name}, rays, maybe"] = float(maybe[-1].numpy().mean())
            del maybe[:]
    mesh_rays = wp.launch(_ray, count, [mesh.id, 3.0, rays.flatten()], [mask], device=device, record_cmd=True).launch
    found["wp.mesh_query_ray_anyhit"] = ns(mesh_rays, count, 3, 2)
    return found


def rays(arguments) -> dict:
    """Ns a ray."""
    count = arguments.count
    x = wp.array(rays_of(arguments, count).reshape(-1), dtype=wp.float32, device=arguments.device)
    out = wp.zeros(count, dtype=wp.bool, device=arguments.device)
    return {"bvh": ns(launch_of(loaded(arguments, "rays-bvh"), x, count, out, False), count, 5, 5)}


@wp.kernel(enable_backward=False)
def _near_surface(seed: int, mesh: wp.uint64, faces: int, reach: float, x: wp.array(dtype=wp.vec3)):
    """A point no farther than ``reach`` from a random point of the surface, mostly nearly as far."""
    i = wp.tid()
    state = wp.rand_init(seed, i)
    a, b = wp.randf(state), wp.randf(state)
    if a + b > 1.0:
        a, b = 1.0 - a, 1.0 - b
    p = wp.mesh_eval_position(mesh, wp.randi(state, 0, faces), a, b)
    way = wp.normalize(wp.vec3(wp.randn(state), wp.randn(state), wp.randn(state)))
    far = wp.randf(state)
    x[i] = p + way * (reach * (1.0 - far * far * far * far))


@wp.kernel(enable_backward=False)
def _around(seed: int, low: wp.vec3, high: wp.vec3, x: wp.array(dtype=wp.vec3)):
    i = wp.tid()
    state = wp.rand_init(seed, i)
    x[i] = low + wp.cw_mul(high - low, wp.vec3(wp.randf(state), wp.randf(state), wp.randf(state)))


@wp.kernel(enable_backward=False)
def _missed(answers: wp.array(dtype=wp.bool), count: wp.array(dtype=wp.int32)):
    i = wp.tid()
    if not answers[i]:
        wp.atomic_add(count, 0, 1)


@wp.kernel(enable_backward=False)
def _over(
    mesh: wp.uint64,
    x: wp.array(dtype=wp.vec3),
    told: wp.array(dtype=float),
    count: wp.array(dtype=wp.int32),
    least: wp.array(dtype=float),
):
    """Counts distances told above the exact one, which float32 computes to some units of the coordinates."""
    i = wp.tid()
    query = wp.mesh_query_point_sign_parity(mesh, x[i], 1.0e6)
    d = wp.float32(0.0)
    if query.result and query.sign > 0.0:
        d = wp.length(x[i] - wp.mesh_eval_position(mesh, query.face, query.u, query.v))
    if told[i] > 0.0:
        wp.atomic_min(least, 0, d - told[i])
    if told[i] > d + 1.0e-6:
        wp.atomic_add(count, 0, 1)


def _vectors(flat: wp.array, count: int) -> wp.array:
    return wp.array(ptr=flat.ptr, dtype=wp.vec3, shape=(count,), device=flat.device)


def hard(arguments) -> dict:
    """False negatives of points that are on the object for certain, overestimates of distances: 1e9 of each."""
    found, count, device = {}, 20_000_000, arguments.device
    mesh, frame = _mesh(arguments), np.load(arguments.data / "bunny.npz")
    rounds = 2 if arguments.quick else 50
    x, missed = wp.zeros(count, dtype=wp.vec3, device=device), wp.zeros(1, dtype=wp.int32, device=device)
    answers = wp.zeros(count, dtype=wp.bool, device=device)
    for name in ("bunny-24", "bunny-50"):
        bounder = loaded(arguments, name)
        missed.zero_()
        prepared = bounder.prepare(x, out=answers)
        for seed in range(rounds):
            wp.launch(_near_surface, count, [seed, mesh.id, len(frame["faces"]), MARGIN - 2e-6], [x], device=device)
            prepared.launch()
            wp.launch(_missed, count, [answers], [missed], device=device)
        found[f"{name}, false negatives"] = [int(missed.numpy()[0]), count * rounds]
        flat = uniform(frame["low"], frame["high"], count, device)
        shares = [float(launch_and_mean(bounder, flat, count, cores)) for cores in (False, True)]
        numbers = bounder.tensor_numbers.numpy()
        found[f"{name}, maybe in float32, on tensor cores"] = shares
        found[f"{name}, threshold, lowered"] = [float(bounder.threshold), float(numbers[0])]
    told, least = wp.zeros(count, dtype=float, device=device), wp.full(1, 1e9, dtype=float, device=device)
    for name in ("bunny-distance-24", "bunny-distance-50"):
        bounder = loaded(arguments, name)
        missed.zero_(), least.fill_(1e9)
        for seed in range(rounds):
            if seed % 2:
                wp.launch(_near_surface, count, [seed, mesh.id, len(frame["faces"]), 0.3], [x], device=device)
            else:
                corners = [wp.vec3(*map(float, frame[name] * 1.5)) for name in ("low", "high")]
                wp.launch(_around, count, [seed, *corners], [x], device=device)
            bounder.distance(x, out=told)
            wp.launch(_over, count, [mesh.id, x, told], [missed, least], device=device)
        found[f"{name}, overestimates"] = [int(missed.numpy()[0]), count * rounds, float(least.numpy()[0])]
    return found


def launch_and_mean(bounder, flat: wp.array, count: int, cores: bool) -> float:
    """The share of *maybe*."""
    out = wp.zeros(count, dtype=wp.bool, device=flat.device)
    launch_of(bounder, flat, count, out, cores)()
    return out.numpy().mean()


def torch_too(arguments) -> dict:
    """Ns a point of the same networks in torch, float32 without TF32, and our function in a kernel."""
    sys_path()
    import torch

    found, count, device = {}, arguments.count, arguments.device
    frame = np.load(arguments.data / "frame.npz")
    flat = uniform(frame["low"], frame["high"], count, device)
    x, out = _vectors(flat, count), wp.zeros(count, dtype=wp.bool, device=device)
    for widths in NETWORKS:
        bounder = loaded(arguments, f"points-{widths[0]}")
        test = bounder.func

        @wp.kernel(module="unique", enable_backward=False)
        def ask(data: wb.Data, x: wp.array(dtype=wp.vec3), out: wp.array(dtype=wp.bool)):
            i = wp.tid()
            out[i] = wp.static(test)(data, x[i])  # noqa: B023  built at once

        found[f"{widths[0]} function"] = ns(
            wp.launch(ask, count, [bounder.data, x], [out], device=device, record_cmd=True).launch, count, 5
        )
        tensor_x = torch.from_numpy(flat.numpy().reshape(-1, 3)).to(device)
        layers = []
        for i in range(len(widths) + 1):
            weight, bias = bounder.tensors[f"layers.{i}.weight"], bounder.tensors[f"layers.{i}.bias"]
            linear = torch.nn.Linear(weight.shape[1], weight.shape[0]).to(device)
            with torch.no_grad():
                linear.weight.copy_(torch.from_numpy(weight.copy())), linear.bias.copy_(torch.from_numpy(bias.copy()))
            layers.append(linear)

        def forward(tensor_x=tensor_x, layers=layers):
            with torch.no_grad():
                h = tensor_x
                for layer in layers[:-1]:
                    h = torch.sin(layer(h))
                return layers[-1](h) < 0.0

        for _ in range(3):
            forward()
        begin, end = torch.cuda.Event(enable_timing=True), torch.cuda.Event(enable_timing=True)
        begin.record()
        for _ in range(5):
            forward()
        end.record()
        torch.cuda.synchronize()
        found[f"{widths[0]} torch"] = begin.elapsed_time(end) * 1e6 / 5 / count
    return found


def counts(arguments) -> dict:
    """Ns a point by batch size: ``prepare``'s launches as a user calls them, and replayed in a graph."""
    found, frame, device = {}, np.load(arguments.data / "frame.npz"), arguments.device
    for count in (1_000, 10_000, 100_000, 1_000_000, 10_000_000, 100_000_000):
        x = _vectors(flat := uniform(frame["low"], frame["high"], count, device), count)
        for widths in ((24, 24), (50, 50)):
            bounder = loaded(arguments, f"points-{widths[0]}")
            prepared = bounder.prepare(x)
            found[f"{widths[0]}, {count}"] = ns(prepared.launch, count, 5)
            with wp.ScopedCapture(device=device) as capture:
                prepared.launch()
            found[f"{widths[0]}, {count}, graph"] = ns(lambda c=capture: wp.capture_launch(c.graph), count, 5)
        del flat
    return found


def graphs(arguments) -> dict:
    """Queries captured in a graph and replayed for others: whether answers are those of a call, and ms of both."""
    found, count, device = {}, min(arguments.count, 1_000_000), arguments.device
    frame = np.load(arguments.data / "frame.npz")
    for name in ("points-24", "points-bvh", "points-kdop", "rays-bvh", "bunny-distance-24"):
        bounder = loaded(arguments, name)
        if name.startswith("rays"):
            rays = rays_of(arguments, 2 * count)
            first, other = (wp.array(x, dtype=wp.float32, device=device) for x in (rays[:count], rays[count:]))
        else:
            sets = (uniform(frame["low"], frame["high"], count, device, seed) for seed in (1, 2))
            kept = list(sets)  # their memory
            first, other = (_vectors(x, count) for x in kept)
        kind = wp.float32 if bounder.of_distances else wp.bool
        out, there = (wp.zeros(count, dtype=kind, device=device) for _ in range(2))
        ask = bounder.distance if bounder.of_distances else bounder.query
        ask(other, out=there)
        x, row = wp.clone(first), {}
        ways = {"query": lambda b=ask, x=x, out=out: b(x, out=out)}
        if not bounder.of_distances:
            ways["prepare"] = bounder.prepare(x, out=out).launch
        for way, call in ways.items():
            wp.copy(x, first)
            with wp.ScopedCapture(device=device) as capture:
                call()
            out.zero_()
            wp.copy(x, other)
            wp.capture_launch(capture.graph)
            row[f"{way}, same"] = bool(np.array_equal(out.numpy(), there.numpy()))
            row[f"{way}, ns"] = ns(call, count, 5)
            row[f"{way}, ns, graph"] = ns(lambda c=capture: wp.capture_launch(c.graph), count, 5)
        if not bounder.of_distances:
            prepared = bounder.prepare(x, candidates=True)
            indices, left = prepared.launch()
            wp.copy(x, first)
            with wp.ScopedCapture(device=device) as capture:
                prepared.launch()
            wp.copy(x, other)
            wp.capture_launch(capture.graph)
            listed = indices.numpy()[: int(left.numpy()[0])]
            row["candidates, same"] = bool(np.array_equal(listed, np.flatnonzero(there.numpy())))
            row["candidates, ns, graph"] = ns(lambda c=capture: wp.capture_launch(c.graph), count, 5)
        found[name] = row
    return found


def _newton_mesh(folder: Path, name: str):
    """One of Newton's meshes, without a reader of meshes."""
    import newton

    kept = np.load(folder / f"newton-{name}.npz")
    return newton.Mesh(kept["vertices"], kept["faces"].reshape(-1))


def _captured(device: str, call):
    """A call as a graph that has been replayed once, to be called; on a CPU, to try the script, itself."""
    if wp.get_device(device).is_cpu:
        call()
        return call
    with wp.ScopedCapture(device=device) as capture:
        call()
    wp.capture_launch(capture.graph)
    return partial(wp.capture_launch, capture.graph)


CELLS = ((10_000, 1), (1_000_000, 1), (100_000, 1), (10_000, 16))  # particles and meshes
# Ways to run the cull in a graph: warps of a multiprocessor among which survivors are shared out (0: 32 in each), by
# place or not, and on a stream of its own or not.
LAYOUTS = {
    "dense": (0, False, True),
    "4 warps": (4, False, True),
    "16 warps": (16, False, True),
    "64 warps": (64, False, True),
    "16 warps, one stream": (16, False, False),
    "dense, by place": (0, True, True),
    "16 warps, by place": (16, True, True),
    "dense, by place, one stream": (0, True, False),
}


def cull(arguments) -> dict:
    """Ms of Newton's particle-shape pass in a captured graph, without and with a cull."""
    sys_path()
    import newton_map

    from warp_bounding.newton import cull as newton_cull
    from warp_bounding.newton import sieve

    captured = partial(_captured, arguments.device)
    newton_map.newton_mesh, records, found = partial(_newton_mesh, arguments.data), newton_map.records, {}
    usual = sieve.WARPS, sieve.SORTED, newton_cull.BESIDE
    for particles, meshes in CELLS[: 1 if arguments.quick else None]:
        sieve.SORTED = 0  # so that there is memory for it
        cell = newton_map.Cell(particles, meshes, 0.05, arguments.device)
        row = {"contacts": cell.compare(), "pairs": cell.cull.pairs}
        row["left"] = [each.survivors for each in (cell.boxes, cell.cull)]
        cell._ways["none"](cell._state, cell._contacts)
        there = records(cell._contacts)
        graphs = {"none": captured(lambda c=cell: c._ways["none"](c._state, c._contacts))}
        for name, (sieve.WARPS, by_place, newton_cull.BESIDE) in LAYOUTS.items():
            sieve.SORTED = 0 if by_place else 2**62
            for way in ("boxes", "distance"):
                try:
                    graph = captured(lambda c=cell, w=way: c._ways[w](c._state, c._contacts))
                except Exception as error:  # the other layouts are worth their time
                    row[f"{way}, {name}, failed"] = f"{type(error).__name__}: {error}"[:500]
                    continue
                graphs[f"{way}, {name}"] = graph
                found_here = records(cell._contacts)
                row[f"{way}, {name}, same contacts"] = all(
                    np.array_equal(a, b) for a, b in zip(there, found_here, strict=True)
                )
            if name in ("16 warps", "16 warps, by place"):
                graphs[f"the cull alone, {name}"] = captured(lambda c=cell: c.cull.candidates(c._state))
        sieve.WARPS, sieve.SORTED, newton_cull.BESIDE = usual
        for turn in range(2):
            for name, graph in graphs.items():
                row[f"{name}, ms, turn {turn}"] = ns(graph, 1_000_000, 5, 20)
        for way in ("none", "boxes", "distance"):  # as a host calls them, which reads the number back
            seconds = [cell._timed(way) for _ in range(12)]
            row[f"{way}, ms, no graph"] = [1e3 * float(np.median(seconds)), 1e3 * min(seconds)]
        found[f"{particles} particles, {meshes} meshes"] = row
        print(particles, meshes, row, flush=True)
    return found


CLOTHS = ((36, 4), (71, 4), (142, 16))  # squares along a side, and meshes


def surfaces(arguments) -> dict:
    """Ms of Newton's passes over whole soft surfaces in a captured graph, in each state, without and with a cull."""
    sys_path()
    import newton_map
    import newton_surfaces

    from sims.prefitted import stored
    from warp_bounding.newton import Cull

    def records(contacts) -> np.ndarray:  # on CUDA their order is by chance
        rows = [row.reshape(len(row), row[:1].size or 1) for row in newton_surfaces.records(contacts)]
        whole = np.concatenate(rows, axis=1, dtype=np.float64)
        return whole[np.lexsort(whole.T[::-1])]

    device, found = arguments.device, {}
    newton_map.newton_mesh = partial(_newton_mesh, arguments.data)
    for side, meshes in CLOTHS[: 1 if arguments.quick else None]:
        model, named, states = newton_surfaces.cloth(side, meshes, device)
        bounders = {name: wb.load(stored("cloth", f"{name}-distance"), device=device) for name in named.values()}
        state, roomy, most = model.state(), newton_surfaces.pipeline_of(model), 0
        contacts = roomy.contacts()
        for q in states:
            state.particle_q.assign(q)
            roomy.collide(state, contacts)
            most = max(most, int(contacts.soft_contact_count.numpy()[0]))
        pipelines = [newton_surfaces.pipeline_of(model, soft_contact_max=2 * most + 1000) for _ in range(3)]
        contacts = pipelines[0].contacts()
        own = {shape: bounders[name] for shape, name in named.items()}
        culls = [Cull(pipe, each, reads_back=False) for pipe, each in zip(pipelines[1:], (None, own), strict=True)]
        graphs, row = {}, {"same contacts": []}
        for name, by in zip(("none", "boxes", "distance"), (pipelines[0], *culls), strict=True):
            call = partial(by.collide, state, contacts)
            call()  # loads kernels
            graphs[name] = _captured(device, call)
        for q in states:
            state.particle_q.assign(q)
            there = []
            for graph in graphs.values():
                graph()
                there.append(records(contacts))
            same = all(np.array_equal(there[0], rows) for rows in there[1:])
            row["same contacts"].append([same, len(there[0])])
            for name, graph in graphs.items():
                row.setdefault(f"{name}, ms", []).append(ns(graph, 1_000_000, 5, 20))
        row["tally"] = {name: str(tally) for name, tally in culls[1].tally().items()}
        found[f"{2 * side**2} triangles, {meshes} meshes"] = row
        print(side, meshes, row, flush=True)
    return found


def motions(arguments) -> dict:
    """Ns a motion of an arm of seven joints among boxes that is proven, with copies to the card and back."""
    found, rng, step = {}, np.random.default_rng(3), np.eye(4)
    step[2, 3] = 0.25
    joints = [wb.arms.Joint(step, ([0, 0, 1], [0, 1, 0])[k % 2], -2.5, 2.5) for k in range(7)]
    links = [wb.arms.Body.capsule([0, 0, 0], [0, 0, 0.25], 0.06, link=k) for k in range(7)]
    arm = wb.arms.Arm(joints, links, touching=[(k, k + 2) for k in range(5)])
    boxes = [wb.arms.Body.box(x - 0.1, x + 0.1) for x in rng.normal((0, 0, 0.8), size=(24, 3))]
    q0 = rng.uniform(arm.lower, arm.upper, (min(arguments.count, 200_000), 7))
    q1 = np.clip(q0 + rng.normal(size=q0.shape) * 0.2, arm.lower, arm.upper)
    answers = []
    for device, count in ((arguments.device, len(q0)), ("cpu", min(len(q0), 20_000))):
        ways = wb.arms.Motions(arm, boxes, device=device)
        ways.segments(q0[:100], q1[:100])
        begin = time.perf_counter()  # a call ends on the host
        answers.append(ways.segments(q0[:count], q1[:count])[0])
        found[f"{device}, ns"] = (time.perf_counter() - begin) * 1e9 / count
    least = min(map(len, answers))
    return found | {
        "clear": float(answers[0].mean()),
        "equal": float((answers[0][:least] == answers[1][:least]).mean()),
    }


def pairs(arguments) -> dict:
    """Ns a pair of placed bunnies, as a batch and as a function in a kernel, and ns a segment that a network clears.

    Answers are compared with those of a CPU, where sums may round differently.
    """
    found, device, count = {}, arguments.device, min(arguments.count, 1_000_000)
    rng, frame = np.random.default_rng(5), np.load(arguments.data / "bunny.npz")
    low, high = (frame[name] for name in ("low", "high"))
    balls = wb.pairs.Balls.load(arguments.data / "bunny-balls.safetensors")
    turns = rng.normal(size=(count, 4))
    places = np.column_stack([rng.uniform(low - high, high - low, (count, 3)), turns]).astype(np.float32)
    places[:, 3:] /= np.linalg.norm(places[:, 3:], axis=1)[:, None]
    places[0] = [0, 0, 0, 0, 0, 0, 1]
    x, out = wp.array(places, dtype=wp.transform, device=device), wp.zeros(count, dtype=wp.bool, device=device)
    for name in ("bunny-distance-24", "bunny-distance-grid-32"):
        pair, some = wb.pairs.Pair(loaded(arguments, name), balls), min(count, 20_000)
        test = pair.func

        @wp.kernel(module="unique", enable_backward=False)
        def ask(data: wb.pairs.PairData, x: wp.array(dtype=wp.transform), out: wp.array(dtype=wp.bool)):
            i = wp.tid()
            out[i] = wp.static(test)(data, x[0], x[i], 0.0)  # noqa: B023  built at once

        there = wb.pairs.Pair(wb.load(arguments.data / f"{name}.safetensors", device="cpu"), balls)
        expected = there.query(places[:1], places[:some]).numpy()
        for way, call in {
            "batch": lambda p=pair: p.query(x[:1], x, out=out),
            "function": wp.launch(ask, count, [pair.data, x], [out], device=device, record_cmd=True).launch,
        }.items():
            found[f"{name}, {way}"] = ns(call, count, 5, 2)
            found[f"{name}, {way}, maybe"] = float(out.numpy().mean())
            found[f"{name}, {way}, as on a CPU"] = float((out.numpy()[:some] == expected).mean())
    starts, ends = (rng.uniform(low, high, (100_000, 3)) for _ in range(2))
    edge, there = (
        wb.proof.Segments(wb.load(arguments.data / "bunny-24.safetensors", device=d)) for d in (device, "cpu")
    )
    clear, _ = edge(starts, ends)
    begin = time.perf_counter()  # a call ends on the host
    edge(starts, ends)
    found["segments, ns"] = (time.perf_counter() - begin) * 1e9 / len(starts)
    expected, _ = there(starts[:2000], ends[:2000])
    found["segments, clear"], found["as on a CPU"] = float(clear.mean()), float((clear[:2000] == expected).mean())
    return found


def choose(arguments) -> dict:
    """What ``choose`` takes on the device, for a narrow phase as expensive as the closest point without a limit."""
    frame = np.load(arguments.data / "bunny.npz")
    shape, found = wb.shapes.Mesh(frame["vertices"], frame["faces"]), {}
    options = {"methods": ("aabb", "kdop", "bvh", "mlp"), "margin": MARGIN}
    own = {f"mlp {w[0]}-{w[0]}, fitted longer": loaded(arguments, f"bunny-{w[0]}") for w in ((24, 24), (50, 50))}
    choice = wb.choose(
        shape, narrow_ns=4.5, device=arguments.device, budget=15.0, bounders=own, progress=False, **options
    )
    found["chosen"], found["why"], found["seconds"] = choice.label, choice.why, choice.about["seconds"]
    found["compile seconds"] = choice.about["compile_seconds"]
    names = ("label", "nbytes", "nanoseconds", "share", "cost", "why_not")
    found["rows"] = [{name: getattr(row, name) for name in names} for row in choice.rows]
    found["prices"] = [each._asdict() for each in choice.prices]
    return found
