"""Verify the bundled bounders of points of closed meshes: ``python tools/verify.py [--out results/verifier]``.

Each file of ``sims/bounders`` that ``python -m verifier`` checks is verified in a process of its own, once as it halves
boxes itself and, of a network, once with the halvings that ``warp-bounding certify --log`` writes. Rows of
``verified.csv`` that are there are kept, so a run that was stopped goes on.
"""

import argparse
import csv
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import warp_bounding as wb
from sims.assets import obj
from sims.cloth.scene import shape
from sims.prefitted import FOLDER

FILES = [f"{scene}-{name}-{method}" for scene, method in (("cloth", "learned-kdop"), ("cloth", "mlp"), ("field", "mlp"))
         for name in ("bunny", "star")]  # fmt: skip
PAGE = """# Verified by a program that shares nothing with the library

`python tools/verify.py --out results/verifier`

[`python -m verifier`](../../docs/verifier.md) of every bundled bounder of points of a closed mesh: the bunny that ships
in warp-lang and a star, with the margins of the cloth demo and of the field of meshes. *Its own*: boxes are halved as
the program itself needs them. *Of a log*: first as `warp-bounding certify --log` has halved them. One process, one
thread (`OMP_NUM_THREADS=1`), on two cores that did other work, too (*busy*): the processor's seconds are what it takes.
Bundled distances and balls are not checked by this program.

"""
COLUMNS = ("file", "halvings", "verdict", "boxes", "seconds", "processor seconds", "MB")


def run(command: list[str]) -> tuple[str, float, float, float]:
    """What a command prints, its seconds, those of the processor, and MB at most."""
    started, most = time.perf_counter(), 0
    process = subprocess.Popen([sys.executable, "-m", "verifier", *command], stdout=subprocess.PIPE, text=True)
    while (ended := os.wait4(process.pid, os.WNOHANG))[0] == 0:
        status = Path(f"/proc/{process.pid}/status").read_text().split()
        most = max(most, int(status[status.index("VmHWM:") + 1]) if "VmHWM:" in status else 0)
        time.sleep(0.02)
    usage = ended[2]
    return process.stdout.read(), time.perf_counter() - started, usage.ru_utime + usage.ru_stime, most / 1024


def main() -> None:
    """Write the table, row by row."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results/verifier"))
    table = parser.parse_args().out / "verified.csv"
    table.parent.mkdir(parents=True, exist_ok=True)
    known = set()
    if table.is_file():
        known = {(row["file"], row["halvings"]) for row in csv.DictReader(table.open())}
    else:
        table.write_text(",".join(COLUMNS) + "\n")
    with tempfile.TemporaryDirectory() as folder:
        for name in FILES:
            mesh, log, file = (
                Path(folder) / f"{name}.obj",
                Path(folder) / "halvings.npz",
                FOLDER / f"{name}.safetensors",
            )
            mesh.write_bytes(obj(shape(name.split("-")[1])))
            for halvings in ("its own", "of a log") if name.endswith("mlp") else ("none",):
                if (name, halvings) in known:
                    continue
                more = ["--log", str(log)] if halvings == "of a log" else []
                if more and not wb.certify(file, mesh, log=log).proven:
                    raise SystemExit(f"{name}: not proven")
                printed, *costs = run([str(file), str(mesh), *more])
                verdict = printed.partition(":")[0]
                boxes = printed.rpartition(", ")[2].split()[0].replace(",", "")
                row = [name, halvings, verdict, boxes, *(f"{cost:.1f}" for cost in costs)]
                with table.open("a") as end:
                    csv.writer(end, lineterminator="\n").writerow(row)
                print(*row, flush=True)
    rows = [COLUMNS, ("---",) * 3 + ("--:",) * 4, *(tuple(row.values()) for row in csv.DictReader(table.open()))]
    lines = "".join(f"| {' | '.join(row)} |\n" for row in rows)
    (table.parent / "README.md").write_text(PAGE + lines)


if __name__ == "__main__":
    main()
