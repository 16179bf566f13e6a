"""``warp-bounding query``: ask a bounder about an array of queries, and write what it answers."""

import io
import time
from typing import Annotated

import numpy as np
import typer

from warp_bounding.cli.options import BounderFile, Device, Json, read_queries
from warp_bounding.cli.output import console, print_json, quiet_warp
from warp_bounding.errors import QueryError
from warp_bounding.runtime.whole_file import ARRAY_FILE, check_writable, write_whole

__all__ = ["command"]


def command(
    file: BounderFile,
    points: Annotated[
        str,
        typer.Argument(metavar="POINTS.npy", help="(N, m) float32 or float64: points, or regions as FILE takes them."),
    ],
    output: Annotated[
        str, typer.Option("--output", "-o", help="File to write (.npy): (N,) uint8, 1 = maybe, 0 = certainly not.")
    ],
    device: Device = "cpu",
    json: Json = False,
) -> int:
    """Ask FILE about every row of POINTS.npy, in object space, and write the answers."""
    from warp_bounding.bounders import load

    quiet_warp(device)
    check_writable(output, file, points, kind=ARRAY_FILE)
    bounder, queries = load(file, device=device), read_queries(points)
    started = time.perf_counter()
    try:
        mask = bounder.query(queries).numpy()
    except QueryError as error:
        raise QueryError(f"{points}: {error}") from error
    seconds = time.perf_counter() - started
    content = io.BytesIO()
    np.save(content, mask)
    write_whole(output, content.getvalue(), ARRAY_FILE)
    maybe = int(mask.sum())
    if json:
        about = {"path": file, "points": points, "output": output}
        about |= {"method": bounder.method, "query": bounder.query_kind}
        print_json({**about, "count": len(mask), "maybe": maybe, "seconds": round(seconds, 6)})
    else:
        share = f" ({100 * maybe / len(mask):.2f} %)" if len(mask) else ""
        asked = f"{len(mask):,} {bounder.query_kind} queries"
        console(False).print(f"{bounder.method}: maybe for {maybe:,} of {asked}{share}; written to {output}")
    return 0
