"""``python -m paper table1|recipes|speed|proofs|figures``, in a clone of the repository.

Each command may be killed at any moment: the same one goes on where it stopped. Its exit status is 1 if something
failed, a promise was found broken or the run was stopped, and 2 for bad input.
"""

import argparse
import importlib
import shlex
import sys
from itertools import pairwise
from pathlib import Path

from paper.gallery import FIGURES
from warp_bounding.errors import BoundingError
from warp_bounding.runtime.progress import quiet_warp


def whole(text: str) -> int:
    """A whole number, which may be written as 1e6."""
    if float(text) != int(float(text)):
        raise ValueError(text)
    return int(float(text))


OPTIONS = {  # type and help; the type of a flag is bool
    "output": (str, "folder; an earlier run is continued"),
    "data": (str, "the paper's folder, with 2D/*.png, 3D/*.binvox, 4D/*.npy"),
    "table": (str, "folder of a table1 run"),
    "columns": (str, "such as 2d-point,3d-ray; or 2d, or ray (default: all)"),
    "methods": (str, "such as aabb,bvh,bvh-64,mlp (default: all)"),
    "objects": (str, "such as bunny (in all dimensions) or 2d/dragon1 (default: all)"),
    "protocol": (str, "truth: exact, sampled as in the paper, or both"),
    "preset": (str, "budgets, samples, both protocols of the table: full, hour"),
    "budget": (str, "seconds of learned fits, as in 20,3d=40,3d-ray:mlp=90"),
    "device": (str, "Warp device (default: cpu)"),
    "devices": (str, "Warp devices, such as cpu,cuda:0 (default: all)"),
    "quick": (bool, "small forms: minutes"),
    "seconds": (float, "time for each fit, or each proof"),
    "length": (float, "length of a ray (default: 1)"),
    "effort": (float, "multiplies the seconds of every fit (default: 1)"),
    "samples": (whole, "random queries, such as 1e6"),
    "queries": (whole, "queries of a race, such as 1e6"),
    "rounds": (whole, "rounds of each race (default: 9)"),
    "positives": (whole, "hard positives of a threshold (default: 1e6)"),
    "seed": (whole, "random seed of the fits; the queries have the next ones (default: 0)"),
}
COMMANDS = {  # options that are required, in capitals, and others
    "table1": "OUTPUT data protocol preset budget columns methods objects seed samples length device",
    "recipes": "DATA OUTPUT columns objects seconds samples seed",
    "speed": "OUTPUT DATA quick columns methods objects devices budget queries rounds samples seed",
    "proofs": "DATA TABLE OUTPUT columns methods objects positives samples seconds",
    "figures": "output quick data effort samples seed",
}


class Parser(argparse.ArgumentParser):
    """Whose errors are one line."""

    def error(self, message: str):
        sys.exit(_told(message))


def parser() -> argparse.ArgumentParser:
    """The command line."""
    whole_line = Parser(prog="paper", description=__doc__)
    commands = whole_line.add_subparsers(dest="command", required=True)
    for name, options in COMMANDS.items():
        command = commands.add_parser(name, help=f"see paper/{name}.py", allow_abbrev=False)
        if name == "figures":
            command.add_argument("name", help=f"{', '.join(FIGURES)}, or all")
        for word in options.split():
            option, required = word.lower(), {"required": True} if word.isupper() else {}
            names = ["--output", "--out", "-o"] if option == "output" else [f"--{option}"]
            kind, text = OPTIONS[option]
            typed = {"action": "store_true"} if kind is bool else {"type": kind}
            command.add_argument(*names, help=text, **typed, **required)
    return whole_line


def _told(error) -> int:
    print(f"paper: {' '.join(str(error).split())}", file=sys.stderr)
    return 2


def run(arguments: list[str] | None = None) -> None:
    """Run a command and exit with its status."""
    words = sys.argv[1:] if arguments is None else arguments
    options = vars(parser().parse_args(words))
    command = options.pop("command")
    shown = [
        "DIR" if before == "--data" else Path(word).name if word.startswith("/") else word
        for before, word in pairwise(["", *words])
    ]  # without this machine's paths
    options["line"] = shlex.join(["python", "-m", "paper", *shown])
    options = {name: value for name, value in options.items() if value is not None}
    quiet_warp()
    try:
        status = importlib.import_module(f"paper.{command}").run(**options)
    except BoundingError as error:
        status = _told(error)
    except KeyboardInterrupt:
        status = 1
    sys.exit(status)


if __name__ == "__main__":
    run()
