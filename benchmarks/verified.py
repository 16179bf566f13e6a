"""Verify bundled bounders of closed meshes: `python benchmarks/verified.py --out results/verifier`.

Each file of ``sims/bounders`` that ``python -m verifier`` checks is verified in a process of its own. A row is written
as it is known; the same command goes on.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from shared import StoredRows

from sims.assets import obj
from sims.cloth.scene import shape
from sims.pile.scene import shapes
from sims.prefitted import FOLDER
from sims.shadows.scene import objects
from warp_bounding.shapes import Mesh

NAMES = ("cloth-bunny-learned-kdop", "cloth-star-learned-kdop")
NAMES += ("cloth-star-distance", "cloth-star-mlp", "cloth-bunny-mlp", "field-bunny-mlp", "field-star-mlp")
NAMES += ("cloth-bunny-distance", "shadows-bunny-distance", "shadows-chair-distance")
NAMES += ("pile-ring-pairs", "pile-bunny-pairs")
ABOUT = """[`python -m verifier`](../../docs/verifier.md) of every bundled bounder of points of a closed mesh, and of
every bundled distance of a network or a grid to one: the bunny that ships in warp-lang, a star, a chair, and a ring,
with the margins of the demos cloth, shadows and pile, and of the field of meshes. One process, one thread
(`OMP_NUM_THREADS=1`). Bundled balls are not checked by this program.

A log of the boxes that the library's proof had halved was built, measured, and dropped: with it the program looked at
1.1 to 1.3 times as many boxes, in 0.77 to 1.05 of the processor's time."""
COLUMNS = ("file", "verdict", "boxes", "seconds", "processor seconds", "MB")


def verified(*given: Path | str) -> dict:
    """What the verifier says, boxes, its seconds, those of the processor, and MB at most."""
    started, most, ended = time.perf_counter(), 0, (0, 0, None)
    command = [sys.executable, "-m", "verifier", *map(str, given)]
    alone = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=alone)
    while ended[0] == 0:  # the process' own most: what ``wait4`` says of memory begins with this one's
        status = Path(f"/proc/{process.pid}/status").read_text().split()
        most = max(most, int(status[status.index("VmHWM:") + 1]) if "VmHWM:" in status else 0)
        time.sleep(0.02)
        ended = os.wait4(process.pid, os.WNOHANG)
    seconds, usage, said = time.perf_counter() - started, ended[2], process.stdout.read()
    costs = {"seconds": seconds, "processor seconds": usage.ru_utime + usage.ru_stime, "MB": most / 1024}
    boxes = int(said.rpartition(", ")[2].split()[0].replace(",", ""))
    return {"verdict": said.partition(":")[0], "boxes": boxes} | {name: round(x, 1) for name, x in costs.items()}


def solid_of(name: str) -> Mesh:
    """The mesh that a bundled bounder is of."""
    scene, solid, *_ = name.split("-")
    if scene == "pile":
        return shapes()[f"pile-{solid}"]
    return objects()[solid] if scene == "shadows" else shape(solid)


def page(rows: StoredRows) -> str:
    """The page of all rows."""
    lines = ["# Verified by a program that shares nothing with the library\n"]
    lines += [f"`python benchmarks/verified.py --out {rows.folder}`\n", f"{rows.about}. {ABOUT}\n"]
    table = [COLUMNS, ("---",) * 2 + ("--:",) * 4, *([f"{row[name]}" for name in COLUMNS] for row in rows.rows)]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in table)]) + "\n"


def main() -> None:
    """Measure what is missing, then write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("results/verifier"))
    rows = StoredRows(parser.parse_args().out, "verified")
    with tempfile.TemporaryDirectory() as folder:
        mesh = Path(folder) / "shape.obj"
        for name in NAMES:
            if rows.have(file=name):
                continue
            mesh.write_bytes(obj(solid_of(name)))
            rows.add({"file": name} | verified(FOLDER / f"{name}.safetensors", mesh))
            print(rows.rows[-1], flush=True)
    rows.write(page(rows))


if __name__ == "__main__":
    main()
