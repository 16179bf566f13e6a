"""``python -m verifier FILE SHAPE [--margin M]``: exit 0 if verified, 1 if not, 2 for bad input."""

import argparse
import hashlib
import sys
from pathlib import Path

import numpy as np

from verifier import files
from verifier.bounders import Claim, parts
from verifier.mesh import Mesh
from verifier.search import Boxes, Look, search


def verify(file: Path, shape: Path, margin: float | None) -> str:
    """What is verified; raises ``ArithmeticError`` with what is not, ``ValueError`` and its like for bad input."""
    tensors, about, sha = files.read_bounder(file)
    vertices, faces = files.read_mesh(shape)
    claims = [Claim(*part) for part in parts(tensors, about)]
    margin = float(about.get("margin") or 0.0) if margin is None else margin
    if not 0 <= margin < np.inf:
        raise ValueError(f"the margin must be a length, got {margin}")
    mesh, used, looked = Mesh(vertices, faces), vertices[np.unique(faces)], 0
    reach = (margin + 2.0**-50 * np.abs(used).max(axis=0)) * (1 + 2.0**-50)
    code = b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py")))
    for i, claim in enumerate(claims):
        claim.check_domain(used.min(axis=0) - reach, used.max(axis=0) + reach)
        if claim.faces:
            claim.check_faces(used, margin)
            continue
        lower, upper = np.array(claim.roots, float).reshape(-1, 2, 3).transpose(1, 0, 2)
        (low, high), every = claim.origins(lower, upper), np.arange(len(faces))
        far = np.inf if claim.unit else margin**2  # a distance is one to all triangles
        items = [np.flatnonzero(mesh.gaps(low, high, i, every) <= far) for i in range(len(lower))]
        root = Boxes(lower, upper, np.array([*map(len, items)]), np.hstack([*items, every[:0]]))
        key = hashlib.sha256(repr((sha, margin, i)).encode() + bytes(vertices) + bytes(faces) + code).hexdigest()
        looked += search(Look(claim, mesh, margin), root, file.with_name(f"{file.name}.verify-{key[:16]}.npz"))
    does = "overestimates no distance to the points" if claims[0].unit else "answers maybe for all points"
    what = f"{file.name} {does} within {margin} of the solid in {shape.name}"
    shown = "; ".join(f"{claim.method}, f >= {claim.threshold!r} + {claim.error:.6g}" for claim in claims)
    return f"verified: {what}: {shown}, {looked:,} boxes"


def main(arguments: list[str] | None = None) -> int:
    """Run the command; the exit status."""
    parser = argparse.ArgumentParser("verifier", description=__doc__.replace("``", ""))
    parser.add_argument("file", type=Path, help="a bounder, .safetensors")
    parser.add_argument("shape", type=Path, help="a closed mesh, .obj, .stl or .ply")
    parser.add_argument("--margin", type=float, help="object units; by default what the file says")
    try:
        print(verify(**vars(parser.parse_args(arguments))))
        return 0
    except ArithmeticError as failure:
        print(f"not verified: {failure}")
        return 1
    except KeyboardInterrupt:
        print("stopped; the same command goes on", file=sys.stderr)
    except Exception as error:  # of files that are not what they should be
        print(f"bad input: {error!r}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
