"""What a GPU says: `python benchmarks/gpu --data FOLDER --out results/gpu`, on a machine with a card; `--prepare` makes the folder, on any machine; `--dry` compiles for sm_90 without a card.

Most important first: what proofs take from the hardware, answers against float64, then times. Each part writes `PART.json` when it is
done, and is left out where that is there, so a run that was stopped goes on.
"""

import argparse
import json
import platform
import subprocess
import sys
import time
from pathlib import Path

import warp as wp

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


def main() -> None:
    """Run the parts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--device", default="cuda:0")
    parser.add_argument("--parts", default=",".join(PARTS))
    parser.add_argument("--count", type=int, default=10_000_000)
    parser.add_argument("--commit", default="")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--prepare", action="store_true")
    arguments = parser.parse_args()
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
