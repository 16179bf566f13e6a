"""What a GPU says: `python benchmarks/gpu --data FOLDER --out results/gpu/NAME`, on a machine with a card.

`--prepare` makes FOLDER before, on any machine: bounders and meshes, so that the machine with the card fits nothing and
reads no mesh files. `--dry` compiles the kernels of tensor cores for sm_90 and counts their instructions; it needs
neither.

The parts: Newton's pass with the cull in a graph; rivals of distances; queries in graphs; `choose`; what proofs take
from the hardware; answers against float64; times; and points and distances that are asked for mistakes. Each part
writes `PART.json` when it is done, and is left out where that is there, so a run that was stopped goes on; `--parts`
takes some of them. All parts take about four minutes, half of them compiling where nothing is compiled yet.
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

from warp_bounding.kernels.functions import batch_kernel
from warp_bounding.networks import tensor_cores
from warp_bounding.networks.inference import MlpSource

sys.path.insert(0, str(Path(__file__).parent))
import closest
import contest
import hardware

PARTS = {
    "cull": contest.cull,
    "closest": closest.closest,
    "graphs": contest.graphs,
    "choose": contest.choose,
    "grids": closest.grids,
    "sine": lambda a: hardware.sine_errors(a.device),
    "sums": lambda a: hardware.sum_errors(a.device, 20_000 if a.quick else 400_000, a.seed),
    "answers": contest.answers,
    "points": contest.points,
    "distances": contest.distances,
    "rays": contest.rays,
    "hard": contest.hard,
    "torch": contest.torch_too,
    "counts": contest.counts,
}


def about(device: str) -> dict:
    """Card, driver and versions."""
    card = wp.get_device(device)
    query = ["nvidia-smi", "--query-gpu=driver_version", "--format=csv,noheader"]
    driver = ""
    if card.is_cuda:
        driver = subprocess.run(query, capture_output=True, text=True, check=False).stdout.strip()
    return {
        "card": card.name,
        "arch": card.arch,
        "driver": driver,
        "warp": wp.__version__,
        "python": platform.python_version(),
    }


def dry() -> None:
    """Compile for sm_90, and count what a thread asks for, on tensor cores of a group of 32 queries; needs no card."""
    kernels = {}
    for query, widths in (("point", (24, 24)), ("point", (50, 50)), ("ray", (50, 50))):
        source = MlpSource(3, False, widths, "sin", query=query)
        kernels[f"{query} {'-'.join(map(str, widths))}"] = batch_kernel(source, False, False, tensor_cores.text(source))
        kernels[f"{query} {'-'.join(map(str, widths))}, float32"] = batch_kernel(source, False, False)
    try:
        from warp_bounding.newton import lists, surface

        kernels["Newton's pass: hulls, lists and their layout"] = lists.sift
        kernels["Newton's passes over surfaces: marks and tables"] = surface.mark_kernel(None)
    except ImportError as error:
        print(error)
    for name, kernel in kernels.items():
        with tempfile.TemporaryDirectory() as folder:
            wp.compile_aot_module(kernel.module, arch=[90], module_dir=folder, use_ptx=True)
            text = next(Path(folder).glob("*.ptx")).read_text()
        sought = ("m16n8k16", "m16n8k8", "sin.approx", "fma.rn.f32", "ld.global", ".local", "atom.")
        print(f"{name}:", ", ".join(f"{word} {text.count(word)}" for word in sought))


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
