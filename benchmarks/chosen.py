"""What `choose` takes in every column of Table 1, by the price of the narrow phase.

`python benchmarks/chosen.py --data DIR --out results/chosen`

Each kind of query of an object of each dimension is one call of `wb.choose`, with all its candidates: every method
that answers it, many in several sizes, and a cascade. A row keeps the whole choice, with the prices at which another
one is the best.
"""

import argparse
import sys
from collections import Counter
from pathlib import Path

from shared import StoredRows

import warp_bounding as wb

OBJECTS = {2: "2D/bunny.png", 3: "3D/bunny.binvox", 4: "4D/bunny.npy"}
QUERIES = ("point", "ray", "plane", "box")
NARROW_NS = 1000.0  # told to `choose`; the prices say what it takes at others
PRICES = (30.0, 100.0, 1e3, 1e4, 1e5)  # of the narrow phase, ns a call, that the page shows
SECONDS = {2: 90.0, 3: 150.0, 4: 240.0}  # of a call, for all fits and measurements


def taken(row: dict, price: float) -> dict:
    """The row of the broad phase that costs the least at a price."""
    label = [stretch["label"] for stretch in row["prices"] if stretch["price"] <= price][-1]
    return next(each for each in row["rows"] if each["label"] == label)


def conclusion(rows: list[dict]) -> str:
    """How often each method is the cheapest, over all columns and prices."""
    counted = Counter(taken(row, price)["label"].split()[0] for row in rows for price in PRICES)
    counted.setdefault("mlp", 0)
    (method, count), *others = counted.most_common()
    rest = ", ".join(f"in {count} `{method}`" for method, count in others)
    return f"In {count} of the {counted.total()} cells below, `{method}` costs the least; {rest}."


def page(kept: StoredRows, command: str) -> str:
    """The page, in Markdown."""
    lines = ["# What `choose` takes in every column of Table 1", "", conclusion(kept.rows), "", f"`{command}`", ""]
    lines += [
        f"{kept.about}. The bunny's grids of 32 cells a side, queries as in Table 1; budgets of "
        f"{', '.join(f'{s:g} s ({n}D)' for n, s in SECONDS.items())} for all fits and measurements of a column. "
        "In each cell what costs the least where the narrow phase takes so many nanoseconds: its bytes, the ns that it "
        "takes itself, the share of all queries that it leaves (and that there must be), and how many "
        "times less a query costs so than without a broad phase. All queries have the same price "
        "here; where those that are left cost more, less is saved. Everything chosen is proven.",
        "",
        f"| | {' | '.join(f'{price:,.0f} ns' for price in PRICES)} |",
        f"|---|{'---|' * len(PRICES)}",
    ]
    for row in kept.rows:
        cells = []
        for price in PRICES:
            own = taken(row, price)
            cost = own["nanoseconds"] + own["share"] * price
            cells.append(
                "none"
                if own["label"] == "none"
                else f"`{own['label']}`, {own['nbytes']:,} B, {own['nanoseconds']:.1f} ns, {100 * own['share']:.1f} % "
                f"({100 * row['positives']:.1f}): {price / cost:.2f} times"
            )
        lines.append(f"| {row['dimension']}D {row['query']} | {' | '.join(cells)} |")
    lines += ["", "All candidates: [chosen.jsonl](chosen.jsonl)."]
    return "\n".join(lines) + "\n"


def main() -> int:
    """Choose where that is missing, then write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="folder with 2D/*.png, 3D/*.binvox, 4D/*.npy")
    parser.add_argument("--out", type=Path, default=Path("results/chosen"))
    parser.add_argument("--effort", type=float, default=1.0, help="multiplies the seconds of every choice")
    options = parser.parse_args()
    kept = StoredRows(options.out, "chosen")
    for dimension, file in OBJECTS.items():
        shape = wb.load_shape(options.data / file)
        for query in QUERIES:
            if kept.have(dimension=dimension, query=query):
                continue
            budget = options.effort * SECONDS[dimension]
            choice = wb.choose(shape, query, narrow_ns=NARROW_NS, budget=budget, device="cpu")
            kept.add(
                {"dimension": dimension, "object": Path(file).stem, "query": query, "budget": budget} | choice.to_dict()
            )
            print(f"{dimension}D {query}: {choice.why}", flush=True)
            kept.write(page(kept, "python benchmarks/chosen.py --data DIR --out results/chosen"))
    kept.write(page(kept, "python benchmarks/chosen.py --data DIR --out results/chosen"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
