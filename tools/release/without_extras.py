"""Load each bounder of the demos with the core alone, ask it in a batch and in a kernel, and fit what is not learned.

It is run by a Python that has the wheel and what the wheel requires, without any extra, in a folder with the files in
``bounders``.
"""

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import warp as wp

import warp_bounding as wb

EXTRAS = (
    "torch",
    "trimesh",
    "matplotlib",
    "PIL",
    "yaml",
    "pxr",
    "pyvista",
    "newton",
    "coal",
    "yourdfpy",
    "sklearn",
    "pytest",
)
assert [name for name in EXTRAS if find_spec(name)] == []  # else this would show nothing

bounders = {path.name: wb.load(path, device="cpu") for path in Path("bounders").glob("*.safetensors")}
rng = np.random.default_rng(0)
for bounder in {bounder.method: bounder for bounder in bounders.values() if bounder.query_kind == "point"}.values():
    nowhere = np.full((8, bounder.ndim), np.nan, np.float32)
    assert bounder.query(nowhere).numpy().all(), bounder.method  # what cannot be tested is answered with maybe

bounder = bounders["path-rooms-mlp.safetensors"]
assert bounder.certificate.proven
domain = bounder.domain
points = (domain.center + rng.uniform(-1.0, 1.0, (100_000, 2)) / domain.scale).astype(np.float32)
mask = bounder.query(points).numpy()
indices, count = bounder.candidates(points)
assert 0 < count.numpy()[0] == mask.sum() < len(points)
assert (indices.numpy()[: mask.sum()] == np.flatnonzero(mask)).all()


@wp.kernel
def ask(data: wb.Data, q: wp.array(dtype=wp.vec2), maybe: wp.array(dtype=int)):
    """Write 1 where the bounder says maybe."""
    i = wp.tid()
    if wp.static(bounder.func)(data, q[i]):
        maybe[i] = 1


maybe = wp.zeros(len(points), dtype=int, device="cpu")
with wp.ScopedDevice("cpu"):
    wp.launch(ask, dim=len(points), inputs=[bounder.data, wp.array(points, dtype=wp.vec2)], outputs=[maybe])
assert (maybe.numpy() == mask).all()

ball = np.linalg.norm(np.indices((16, 16, 16)) - 7.5, axis=0) < 6
assert wb.fit(ball, method="kdop", device="cpu").certificate.proven  # what is not learned needs no torch

print(f"{len(bounders)} bounders")
