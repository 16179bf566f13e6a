"""``python tests/fuzz --minutes 60 --seed 1 --out DIR``: the mutation fuzzer for as long as one likes; Ctrl-C ends it.

Exit status 1 if a lie was accepted, a file crashed the library, or one did not end. An iteration depends on the seed,
its number and ``--among`` alone; what is found is printed with the command that repeats it.
"""

import argparse
import json
import os
import shlex
import sys
from pathlib import Path


def main() -> int:
    sys.path.insert(0, str(Path(__file__).parents[1] / "shared"))
    os.environ["WARP_BOUNDING_THREADS"] = "1"  # what does not end is interrupted, and must not leave threads at work
    import warp as wp

    wp.config.log_level = getattr(wp, "LOG_ERROR", 40)
    wp.config.quiet = True
    from fuzzing import fuzz
    from subjects import subjects

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--files", type=float, default=float("inf"), help="at most so many")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first file")
    parser.add_argument("--among", default="", help="only subjects whose name holds this, such as 'learned-kdop plane'")
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"), help="folder for what is found")
    queried = parser.parse_args()
    among = [subject for subject in subjects() if queried.among in subject.name]
    if not among:
        parser.error(f"--among must be part of a subject's name, got {queried.among!r}")

    def progress(tally, seconds: float) -> None:
        if tally.counts["files"] % 100 == 0:
            print(f"{seconds / 60:6.1f} min: {tally}", flush=True)

    limits = {"iterations": queried.files, "seconds": 60 * queried.minutes, "first": queried.first}
    tally = fuzz(queried.seed, **limits, among=among, out=queried.out, progress=progress)
    print(tally)
    among = f" --among {shlex.quote(queried.among)}" * bool(queried.among)
    for record in tally.found[:20]:
        print(json.dumps({k: v for k, v in record.items() if k != "error"}))
        print(f"again: python tests/fuzz --seed {queried.seed} --first {record['iteration']} --files 1{among}")
        print(record.get("error", "").strip().splitlines()[-1:])
    return 1 if tally.found else 0


if __name__ == "__main__":
    sys.exit(main())
