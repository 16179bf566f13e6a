"""What a mesh answers without a grid, in millions a second: `python benchmarks/shapes.py [--mesh FILE] [--margin 0.012]`.

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

COUNT = 200_000  # queries of a kind
NEAR = 0.01  # of the extent: how far queries lie from the border, and how large boxes are


def near_border(shape: wb.IndicatorMesh, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Boxes near the border of the dilated mesh."""
    size = NEAR * float(shape.extent.max())
    corners = shape.vertices.astype(np.float64)[shape.faces[rng.integers(len(shape.faces), size=COUNT)]]
    way = rng.normal(size=(COUNT, 3))
    way *= (shape.margin + size * rng.uniform(-2, 4, (COUNT, 1))) / np.linalg.norm(way, axis=1, keepdims=True)
    middle, half = corners.mean(axis=1) + way, size * rng.uniform(0.1, 0.5, (COUNT, 1))
    return middle - half, middle + half


def measure(shape: wb.IndicatorMesh) -> dict[str, dict]:
    """Of each question its rate, and the share of answers that are certain or positive."""
    rng = np.random.default_rng(0)
    low, high = near_border(shape, rng)
    x, y = rng.uniform(shape.sample_lower, shape.sample_upper, (2, COUNT, 3))
    asked = {
        "decide": (low,),
        "empty": (low, high),
        "inside": (low, high),
        "distance": (low,),
        "clearance": (low, high),
        "decide_boxes": (np.minimum(x, y), np.maximum(x, y)),
        "decide_segments": (x, y),
        "decide_planes": (y - x, x),
    }
    rows = {}
    for name, queries in asked.items():
        ask = getattr(shape, name)
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
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    wp.config.quiet = True
    mesh = wb.load_indicator(arguments.mesh)
    mesh.decide(np.zeros((1, 3)))  # kernels are compiled
    mesh = wb.IndicatorMesh(mesh.vertices, mesh.faces, name=mesh.name)
    start = time.process_time()
    mesh.decide(mesh.bounds[:1])
    built = round(time.process_time() - start, 2)
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
