"""What a GPU says: `python benchmarks/gpu --data FOLDER --out results/gpu/NAME`, on a machine with a card.

`--prepare` makes FOLDER before, on any machine: bounders and meshes, so that the machine with the card fits nothing and
reads no mesh files. `--dry` compiles the kernels of tensor cores for sm_90 and counts their instructions; it needs
neither.

Most important first: what proofs take from the hardware, answers against float64, times, and points and distances that
are asked for mistakes. Each part writes `PART.json` when it is done, and is left out where that is there, so a run that
was stopped goes on. All parts take about two minutes, as much again where nothing is compiled yet.
"""

import argparse
import json
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import warp as wp

from warp_bounding.kernels.functions import warp_kernel
from warp_bounding.networks import tensor_cores
from warp_bounding.networks.inference import MlpSource

sys.path.insert(0, str(Path(__file__).parent))
import contest
import hardware

PARTS = {
    "sine": lambda a: hardware.sine_errors(a.device),
    "sums": lambda a: hardware.sum_errors(a.device, 20_000 if a.quick else 400_000, a.seed),
    "answers": contest.answers,
    "points": contest.points,
    "distances": contest.distances,
    "rays": contest.rays,
    "hard": contest.hard,
    "torch": contest.torch_too,
    "counts": contest.counts,
    "cull": contest.cull,
}


def about(device: str) -> dict:
    """Card, driver and versions."""
    card = wp.get_device(device)
    query = ["nvidia-smi", "--query-gpu=driver_version", "--format=csv,noheader"]
    driver = subprocess.run(query, capture_output=True, text=True, check=False).stdout.strip()
    return {
        "card": card.name,
        "arch": card.arch,
        "driver": driver,
        "warp": wp.__version__,
        "python": platform.python_version(),
    }


def dry() -> None:
    """Compile the kernels of tensor cores for sm_90, and count what a group of 32 queries asks for; needs no card."""
    for query, widths in (("point", (24, 24)), ("point", (50, 50)), ("ray", (50, 50))):
        source = MlpSource(3, False, widths, "sin", query=query)
        kernel = warp_kernel(source, False, False, tensor_cores.text(source))
        with tempfile.TemporaryDirectory() as folder:
            wp.compile_aot_module(kernel.module, arch=[90], module_dir=folder, use_ptx=True)
            text = next(Path(folder).glob("*.ptx")).read_text()
        counts = {
            name: text.count(name)
            for name in ("m16n8k16", "m16n8k8", "sin.approx", "fma.rn.f32", "ld.global", ".local")
        }
        print(query, "-".join(map(str, widths)), ", ".join(f"{name} {count}" for name, count in counts.items()))


def main() -> None:
    """Run the parts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--dry", action="store_true")
    parser.add_argument("--data", type=Path)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--device", default="cuda:0")
    parser.add_argument("--parts", default=",".join(PARTS))
    parser.add_argument("--count", type=int, default=10_000_000)
    parser.add_argument("--commit", default="")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--prepare", action="store_true")
    arguments = parser.parse_args()
    if arguments.dry:
        dry()
        return
    if arguments.data is None or not (arguments.prepare or arguments.out):
        parser.error("expected --dry, or --data with --prepare or with --out")
    if arguments.prepare:
        contest.prepare(arguments.data)
        return
    arguments.out.mkdir(parents=True, exist_ok=True)
    known = about(arguments.device) | {"commit": arguments.commit, "count": arguments.count}
    for name in arguments.parts.split(","):
        file = arguments.out / f"{name}.json"
        if file.exists():
            continue
        started = time.perf_counter()
        try:
            found = PARTS[name](arguments)
        except Exception as error:  # the other parts are worth their time
            import traceback

            traceback.print_exc()
            print(f"{name}: {type(error).__name__}: {error}", flush=True)
            continue
        seconds = round(time.perf_counter() - started, 2)
        file.write_text(json.dumps(known | {"part": name, "seconds": seconds, "found": found}, indent=1) + "\n")
        print(name, seconds, "s", json.dumps(found)[:1800], flush=True)


if __name__ == "__main__":
    main()
