"""Distances without a limit, asked in a kernel: bounders, Warp's exact queries, and distances stored on grids.

A rival's number is *over* where it exceeds the distance to the object, which is 0 in it, by more than float32 makes of
the exact one, 1e-6.
"""

import numpy as np
import warp as wp
from contest import MARGIN, _distance, _mesh, _vectors, loaded, ns, uniform

import warp_bounding as wb

OWN = ("bunny-distance-24", "bunny-distance-50", *(f"bunny-distance-grid-{size}" for size in ("32", "64")))
NODES = (32, 64, 128)  # of the rivals' grids, along the longest side
WITHIN = 0.1
SLACK = 1e-6


@wp.kernel(enable_backward=False)
def _outside(mesh: wp.uint64, x: wp.array(dtype=wp.vec3), inside_too: bool, out: wp.array(dtype=float)):
    i = wp.tid()
    query = wp.mesh_query_point_sign_parity(mesh, x[i], 1.0e6)
    d = query.sign * wp.length(x[i] - wp.mesh_eval_position(mesh, query.face, query.u, query.v))
    out[i] = wp.where(inside_too, d, wp.max(d, 0.0))


@wp.kernel(enable_backward=False)
def _sphere(mesh: wp.uint64, radius: float, x: wp.array(dtype=wp.vec3), out: wp.array(dtype=float)):
    """Whether a triangle is as near as that."""
    i, face = wp.tid(), wp.int32(0)
    query = wp.mesh_query_sphere(mesh, x[i], radius)
    out[i] = 1.0
    if wp.mesh_query_next(query, face):
        out[i] = 0.0


@wp.kernel(enable_backward=False)
def _volume(volume: wp.uint64, x: wp.array(dtype=wp.vec3), out: wp.array(dtype=float)):
    i = wp.tid()
    out[i] = wp.volume_sample_f(volume, wp.volume_world_to_index(volume, x[i]), wp.Volume.LINEAR)


def _function(bounder):
    distance = bounder.func

    @wp.kernel(module="unique", enable_backward=False)
    def ask(data: wb.Data, x: wp.array(dtype=wp.vec3), out: wp.array(dtype=float)):
        i = wp.tid()
        out[i] = wp.static(distance)(data, x[i])

    return ask


def _textures(arguments, x: wp.array, row) -> None:
    """Newton's distances in textures, read by software interpolation and by the card's."""
    import newton
    from newton._src.geometry import sdf_texture

    kept = np.load(arguments.data / "bunny.npz")
    mesh = newton.Mesh(kept["vertices"], kept["faces"].reshape(-1))

    def kernel_of(sample):
        @wp.kernel(module="unique", enable_backward=False)
        def ask(sdf: sdf_texture.TextureSDFData, x: wp.array(dtype=wp.vec3), out: wp.array(dtype=float)):
            i = wp.tid()
            out[i] = wp.static(sample)(sdf, x[i])

        return ask

    ways = {
        name: kernel_of(getattr(sdf_texture, f"texture_sample_sdf{end}"))
        for name, end in (("", ""), (" of the card", "_hw"))
    }
    for nodes in NODES:
        sdf = newton.SDF.create_from_mesh(mesh, device=arguments.device, max_resolution=nodes, margin=2 * MARGIN)
        data = sdf.to_texture_kernel_data()
        nbytes = sum(_texture_bytes(texture) for texture in (sdf._coarse_texture, sdf._subgrid_texture))
        nbytes += data.subgrid_start_slots.size * 4
        for name, kernel in ways.items():
            row(f"Newton's texture of {nodes}, interpolation{name}", kernel, [data, x], nbytes)


def _texture_bytes(texture) -> int:
    cells = texture.width * texture.height * texture.depth * texture.num_channels
    return cells * np.dtype(wp.dtype_to_numpy(texture.dtype)).itemsize


def closest(arguments) -> dict:
    """Of each: ns a point in a kernel, bytes, how often it is over, the most, and how much less on average."""
    frame, count, device = np.load(arguments.data / "frame.npz"), arguments.count, arguments.device
    mesh, found = _mesh(arguments), {}
    flat = uniform(frame["low"], frame["high"], count, device)
    x, told = _vectors(flat, count), wp.zeros(count, dtype=float, device=device)
    wp.launch(_outside, count, [mesh.id, x, False], [told], device=device)
    exact = told.numpy()
    triangles = sum(array.size * wp.types.type_size_in_bytes(array.dtype) for array in (mesh.points, mesh.indices))

    def row(name: str, kernel, inputs: list, nbytes: int, compared: bool = True, call=None) -> None:
        told.fill_(7e7)
        call = call or wp.launch(kernel, count, inputs, [told], device=device, record_cmd=True).launch
        found[name] = {"ns": ns(call, count, 3, 3), "bytes": int(nbytes)}
        if compared:
            over = told.numpy().astype(np.float64) - exact
            found[name] |= {
                "over": int((over > SLACK).sum()),
                "most": float(over.max()),
                "less": float(np.maximum(-over, 0.0)[exact > 0].mean()),
            }
        print(name, found[name], flush=True)

    for name in OWN:
        if not (arguments.data / f"{name}.safetensors").exists():
            found[f"{name}, not prepared"] = None
            continue
        bounder = loaded(arguments, name)
        row(f"{name}, function", _function(bounder), [bounder.data, x], bounder.nbytes)
        row(f"{name}, batch", None, [], bounder.nbytes, call=lambda b=bounder: b.distance(x, out=told))
    row("wp.mesh_query_point, no limit", _distance, [mesh.id, 1e6, x], triangles, compared=False)
    row(f"wp.mesh_query_point within {WITHIN}", _distance, [mesh.id, WITHIN, x], triangles, compared=False)
    for radius in (MARGIN, WITHIN):
        row(f"wp.mesh_query_sphere, any within {radius}", _sphere, [mesh.id, radius, x], triangles, compared=False)
    for nodes in NODES:
        low, high = frame["low"].astype(np.float64), frame["high"].astype(np.float64)
        size = float((high - low).max()) / (nodes - 1)
        shape = np.ceil((high - low) / size).astype(int) + 1
        at = low + size * np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1)
        places = wp.array(at.reshape(-1, 3).astype(np.float32), dtype=wp.vec3, device=device)
        values = wp.zeros(len(places), dtype=float, device=device)
        wp.launch(_outside, len(places), [mesh.id, places, True], [values], device=device)
        grid = values.numpy().reshape(shape)
        volume = wp.Volume.load_from_numpy(
            grid, tuple(map(float, low)), size, bg_value=float(grid.max()), device=device
        )
        row(f"NanoVDB volume of {nodes}", _volume, [volume.id, x], volume.array().size)
    if wp.get_device(device).is_cuda:
        try:
            _textures(arguments, x, row)
        except Exception as error:  # the other rows are worth their time
            found["Newton's textures, failed"] = f"{type(error).__name__}: {error}"[:500]
    return found
