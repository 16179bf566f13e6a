"""What a mesh answers without a grid, in millions a second: `python benchmarks/exact_mesh.py [--mesh FILE] [--moving]`.

Points and boxes lie near the border of the dilated mesh, where a branch and bound asks; segments, planes and large
boxes are drawn from all of the domain. Seconds are those of the processor, so a busy machine does not matter; rates are
for two cores.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
import warp as wp

import warp_bounding as wb
from warp_bounding.queries.boundary import border_points
from warp_bounding.shapes.shape import Shape

COUNT = 200_000  # queries of a kind
NEAR = 0.01  # of the extent: how far queries lie from the border, and how large boxes are


def near_border(shape: Shape, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Boxes near the border of the dilated mesh, at rest or at some time of its motion."""
    size = NEAR * float(shape.extent.max())
    middle = border_points(shape, COUNT // 8, rng)[rng.integers(COUNT // 8, size=COUNT)]
    space = slice(int(shape.time), None)
    middle[:, space] += size * rng.normal(size=(COUNT, shape.ndim))[:, space]
    half = np.zeros_like(middle)
    half[:, space] = size * rng.uniform(0.1, 0.5, (COUNT, 1))
    if shape.time:
        half[:, 0] = NEAR * (shape.upper[0] - shape.lower[0]) * rng.uniform(0.1, 0.5, COUNT)
    return middle - half, middle + half


def measure(shape: Shape) -> dict[str, dict]:
    """Of each question its rate, and the share of answers that are certain or positive."""
    rng = np.random.default_rng(0)
    low, high = near_border(shape, rng)
    x, y = rng.uniform(shape.sample_lower, shape.sample_upper, (2, COUNT, shape.ndim))
    queried = {
        "decide": (low,),
        "empty": (low, high),
        "inside": (low, high),
        "distance": (low,),
        "decide_boxes": (np.minimum(x, y), np.maximum(x, y)),
        "decide_segments": (x, y),
        "decide_planes": (y - x, x),
    }
    rows = {}
    for name, queries in queried.items():
        ask = getattr(shape, name)
        if ask is None or ask(*(q[:1] for q in queries)) is None:  # what this shape does not tell
            continue
        ask(*(q[:10] for q in queries))
        start = time.process_time()
        answers = ask(*queries)
        seconds = time.process_time() - start
        rows[name] = {"millions_a_second": round(2 * COUNT / seconds / 1e6, 2), "mean": round(float(answers.mean()), 4)}
    return rows


def main() -> None:
    """Build what a mesh asks its triangles with, ask it everything, and print rates."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    bunny = Path(wp.__file__).parent / "examples" / "assets" / "bunny.usd"
    parser.add_argument("--mesh", type=Path, default=bunny, help="any mesh file; Warp's bunny by default")
    parser.add_argument("--margin", type=float, default=0.012, help="share of the longest side")
    parser.add_argument(
        "--moving", action="store_true", help="the mesh turns, twists and swells, as in the particles demo"
    )
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    wp.config.quiet = True
    mesh = wb.load_shape(arguments.mesh)
    mesh.decide(np.zeros((1, 3)))  # kernels are compiled
    mesh = wb.shapes.Mesh(mesh.vertices, mesh.faces, name=mesh.name)
    start = time.process_time()
    mesh.decide(mesh.bounds[:1])
    built = round(time.process_time() - start, 2)
    if arguments.moving:
        from sims.particles.scene import moving

        mesh = moving(mesh)
    shape = mesh.dilated(arguments.margin * float(mesh.extent.max()))
    result = {"mesh": repr(shape), "build_seconds": built, "questions": measure(shape)}
    if arguments.json:
        print(json.dumps(result, indent=1))
        return
    print(f"{result['mesh']}\nbuilt in {built} s; rates on two cores")
    for name, row in result["questions"].items():
        print(f"{name:16} {row['millions_a_second']:6.2f} M/s   mean answer {row['mean']}")


if __name__ == "__main__":
    main()
