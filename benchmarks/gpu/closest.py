"""Distances without a limit, asked in a kernel: bounders, Warp's exact queries, and distances stored on grids.

A rival's number is *over* where it exceeds the distance to the object, which is 0 in it, by more than float32 makes of
the exact one, 1e-6.
"""

import numpy as np
import warp as wp
from contest import MARGIN, _distance, _mesh, _vectors, loaded, ns, uniform

import warp_bounding as wb

NETWORKS = ("bunny-distance-24", "bunny-distance-50")
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
    distance = bounder.distance_func

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


class Rows:
    """Rows by name: ns a point, bytes, how often a number is over, the most, and how much less it is on average."""

    def __init__(self, arguments):
        self.count, self.device, self.found = arguments.count, arguments.device, {}
        self.frame, self.mesh = np.load(arguments.data / "frame.npz"), _mesh(arguments)
        self._flat = uniform(self.frame["low"], self.frame["high"], self.count, self.device)  # the memory of x
        self.x, self.told = _vectors(self._flat, self.count), wp.zeros(self.count, dtype=float, device=self.device)
        wp.launch(_outside, self.count, [self.mesh.id, self.x, False], [self.told], device=self.device)
        self._exact = self.told.numpy().copy()

    def add(self, name: str, kernel, inputs: list, nbytes: int, compared: bool = True, call=None) -> None:
        """Measure a kernel, or a call, that writes to ``told``."""
        self.told.fill_(7e7)
        if call is None:
            launch = wp.launch(kernel, self.count, inputs, [self.told], device=self.device, record_cmd=True)
            call = launch.launch
        self.found[name] = {"ns": ns(call, self.count, 3, 3), "bytes": int(nbytes)}
        if compared:
            over = self.told.numpy().astype(np.float64) - self._exact
            self.found[name] |= {
                "over": int((over > SLACK).sum()),
                "most": float(over.max()),
                "less": float(np.maximum(-over, 0.0)[self._exact > 0].mean()),
            }
        print(name, self.found[name], flush=True)

    def own(self, name: str, bounder) -> None:
        """A distance, as a function and in a batch."""
        self.add(f"{name}, function", _function(bounder), [bounder.data, self.x], bounder.nbytes)
        self.add(f"{name}, batch", None, [], bounder.nbytes, call=lambda: bounder.distance(self.x, out=self.told))


def closest(arguments) -> dict:
    """Networks, Warp's exact queries, and numbers stored on grids."""
    rows, frame, device = Rows(arguments), np.load(arguments.data / "frame.npz"), arguments.device
    x, mesh = rows.x, rows.mesh
    triangles = sum(array.size * wp.types.type_size_in_bytes(array.dtype) for array in (mesh.points, mesh.indices))
    for name in NETWORKS:
        rows.own(name, loaded(arguments, name))
    rows.add("wp.mesh_query_point, no limit", _distance, [mesh.id, 1e6, x], triangles, compared=False)
    rows.add(f"wp.mesh_query_point within {WITHIN}", _distance, [mesh.id, WITHIN, x], triangles, compared=False)
    for radius in (MARGIN, WITHIN):
        rows.add(f"wp.mesh_query_sphere, any within {radius}", _sphere, [mesh.id, radius, x], triangles, compared=False)
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
        rows.add(f"NanoVDB volume of {nodes}", _volume, [volume.id, x], volume.array().size)
    if wp.get_device(device).is_cuda:
        try:
            _textures(arguments, x, rows.add)
        except Exception as error:  # the other rows are worth their time
            rows.found["Newton's textures, failed"] = f"{type(error).__name__}: {error}"[:500]
    return rows.found


def grids(arguments) -> dict:
    """Our own distances on grids, fitted here where they are not prepared."""
    rows, kept = Rows(arguments), np.load(arguments.data / "bunny.npz")
    for nodes in (32, 64):
        name = f"bunny-distance-grid-{nodes}"
        if (arguments.data / f"{name}.safetensors").exists():
            rows.own(name, loaded(arguments, name))
        elif nodes == 32:
            shape, options = wb.shapes.Mesh(kept["vertices"], kept["faces"]), {"nodes": nodes, "progress": False}
            rows.own(name, wb.fit(shape, "distance", "distance-grid", device=arguments.device, **options))
    return rows.found
