"""What a GPU says: `python benchmarks/gpu --data FOLDER --out results/gpu/NAME`, on a machine with a card.

`--prepare` makes FOLDER before, on any machine: bounders and meshes, so that the machine with the card fits nothing and
reads no mesh files. `--dry` compiles kernels for sm_90 and counts their instructions; it needs neither. It counts in
machine code, and writes `counted.json` if there is an `--out`, where the packages nvidia-cuda-nvdisasm and
nvidia-cuda-cuobjdump are installed, or their tools are on the path; else it counts words of PTX.

The parts: Newton's passes with the cull in a graph; rivals of distances; queries in graphs; pairs; motions of arms;
`choose`; what proofs take from the hardware; answers against float64; times; and points and distances that are asked
for mistakes. Each part writes `PART.json` when it is done, and is left out where that is there, so a run that was
stopped goes on; `--parts` takes some of them. All parts take about four minutes, half of them compiling where nothing
is compiled yet.
"""

import argparse
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import time
from pathlib import Path

import warp as wp

import warp_bounding as wb
from warp_bounding.arms.motions import _kernels as motions_kernels
from warp_bounding.kernels.functions import batch_kernel
from warp_bounding.networks import tensor_cores
from warp_bounding.networks.inference import MlpSource
from warp_bounding.networks.inference import _block as block_of

sys.path.insert(0, str(Path(__file__).parent))
import closest
import contest
import hardware

PARTS = {
    "cull": contest.cull,
    "surfaces": contest.surfaces,
    "closest": closest.closest,
    "graphs": contest.graphs,
    "pairs": contest.pairs,
    "motions": contest.motions,
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


# Instructions by the pipe that takes them; a load is of 32 bits, of 64 or of 128, and takes as many clocks as it has
# times 32. All others go to *other*.
PIPES = {
    "FP32": ("FFMA", "FMUL", "FADD", "FSETP", "FMNMX", "FSEL"),
    "loads": ("LDG", "LDL", "LDS"),
    "local": ("LDL", "STL"),
    "MUFU": ("MUFU",),
    "HMMA": ("HMMA",),
}
TOOLS = ("nvdisasm", "cuobjdump")
IN_PTX = ("mma.sync", "sin.approx", "fma.rn.f32", "ld.global", ".local", "atom.")
H100 = 132 * 1.755  # multiprocessors, clocks a ns


def _tool(name: str) -> str | None:
    """Where a tool is, on the path or in a package of NVIDIA's."""
    folders = Path(sysconfig.get_path("purelib")).glob("nvidia/*/bin")
    return shutil.which(name) or shutil.which(name, path=os.pathsep.join(map(str, folders)))


def counted(kernel: wp.Kernel, queries: int | None = None, turns: int = 1) -> dict:
    """What a query costs in machine code for sm_90; without the tools that read it, how often words stand in PTX.

    A thread answers ``queries`` and runs each innermost loop ``turns`` times. Without ``queries`` only registers and
    stack are counted. Times are lower bounds for an H100. They assume that each scheduler issues one instruction a
    clock, and that each multiprocessor loads 32 bits for each lane of a warp in a clock.
    """
    tools = list(map(_tool, TOOLS))
    with tempfile.TemporaryDirectory() as folder:
        wp.compile_aot_module(kernel.module, arch=[90], module_dir=folder, use_ptx=not all(tools))
        if not all(tools):
            text = next(Path(folder).glob("*.ptx")).read_text()
            return {word: text.count(word) for word in IN_PTX}
        cubin = next(Path(folder).glob("*.cubin"))
        listing, usage = (
            subprocess.run([tool, option, cubin], capture_output=True, text=True, check=True).stdout
            for tool, option in zip(tools, ("-c", "--dump-resource-usage"), strict=True)
        )
    found = {what: max(map(int, re.findall(rf"{what}:(\d+)", usage))) for what in ("REG", "STACK")}
    if queries is None:
        return found
    code, labels = [], {}
    for line in listing[listing.index("\n.text.") :].splitlines():
        if own := re.match(r"(\.L_x_\d+):", line):
            labels[own[1]] = len(code)
        elif own := re.match(r"\s+/\*\w{4,}\*/\s+(.*);", line):
            code.append(re.sub(r"^@!?U?P\w+ +", "", own[1].strip()))
    code = code[: max(i for i, each in enumerate(code) if each == "EXIT")]  # behind it there are divisions of integers
    jumps = [(labels[to[1]], i) for i, each in enumerate(code) if (to := re.search(r"BRA `\((.*)\)", each))]
    loops = [jump for jump in jumps if jump[0] <= jump[1]]
    inner = [(a, b) for a, b in loops if not any(a <= c and d <= b and (a, b) != (c, d) for c, d in loops)]
    issued, total, clocks = dict.fromkeys([*PIPES, "other"], 0.0), 0.0, 0.0
    for i, each in enumerate(code):
        name, *kinds = each.split()[0].split(".")
        times = (turns if any(a <= i <= b for a, b in inner) else 1) / queries
        for pipe in [pipe for pipe, names in PIPES.items() if name in names] or ["other"]:
            issued[pipe] += times
        total += times
        if name in PIPES["loads"]:
            clocks += times * (4 if "128" in kinds else 2 if "64" in kinds else 1)
    return {
        **found,
        "queries a thread": queries,
        "issued": round(total),
        **{pipe: round(count) for pipe, count in issued.items()},
        "ns to issue": round(total / 4 / 32 / H100, 4),
        "ns to load": round(clocks / 32 / H100, 4),
    }


def dry() -> dict:
    """Compile for sm_90, and count what a query costs; needs no card."""
    kernels = {}
    for widths in ((24, 24), (32, 32), (50, 50)):
        source = MlpSource(3, False, widths, "sin")
        name, turns = f"point {'-'.join(map(str, widths))}", widths[-1] // block_of(widths[-1])
        kernels[name] = batch_kernel(source, False, False, tensor_cores.text(source)), 1, 1
        kernels[f"{name}, float32"] = batch_kernel(source, False, False), source.several, turns
    try:
        from sims.prefitted import stored
        from warp_bounding.newton import lists, surface

        kernels["Newton's pass: hulls, lists and their layout"] = (lists.sift,)
        far = wb.load(stored("cloth", "bunny-distance"), device="cpu")
        kernels["Newton's passes over surfaces: balls and tables"] = (surface.place_faces,)
        kernels["Newton's passes over surfaces: marks"] = (surface.mark_kernel(None),)
        kernels["whole motions of arms"] = (motions_kernels().segments,)
        kernels["Newton's passes over surfaces: marks of a bounder"] = (surface.mark_kernel(far.source),)
    except ImportError as error:
        print(error)
    return {name: counted(*about) for name, about in kernels.items()}


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
        if arguments.out and not all(map(_tool, TOOLS)):
            parser.error("--out needs machine code: pip install nvidia-cuda-nvdisasm nvidia-cuda-cuobjdump")
        found = dry()
        print(*(f"{name}: {costs}" for name, costs in found.items()), sep="\n")
        if arguments.out:
            (arguments.out / "counted.json").write_text(json.dumps(found, indent=1) + "\n")
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
