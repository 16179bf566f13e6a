"""The paper's own training beside ours in the same time: rows for the page of ``table1``."""

from pathlib import Path
from typing import Any

from paper import results
from paper.cells import Cell, about, missing, select
from paper.results import markdown
from paper.table import COLUMNS, Variant, column_of, words_of
from warp_bounding.bounders.mlp import RECIPE, RECIPES, Mlp
from warp_bounding.errors import BounderError, QueryError

NAME = "recipes"  # also the folder in a folder of ``table1``
CSV = """dimension object query method way steps steps_asked step_seconds fp_rate fn fp_zero fn_zero positives
    certificate fit_seconds nbytes hidden seconds samples seed length threads indicator versions""".split()
DEFAULTS = {"seconds": 600.0, "samples": 400_000, "seed": 0, "length": 1.0}
OCTAVES = 4  # of the positional encoding: 18 inputs in 2D, as in the supplement
WAYS = {
    f"{recipe}{'+encoding' if octaves else ''}": (recipe, octaves) for recipe in RECIPES for octaves in (0, OCTAVES)
}
POINTS = ",".join(c.name for c in COLUMNS if not c.kind.is_region)  # what is compared where no columns are named


def run(data, table, columns=None, objects=None, ways=None, seconds=None, samples=None, seed=None) -> int:
    """Train the paper's network by its recipe and by ours in the same time, with its positional encoding and without.

    Planes have neither.
    """
    from paper import table1

    results.read_settings(Path(table))
    chosen = list(dict.fromkeys(words_of(ways) or WAYS))
    for way in chosen:
        if way not in WAYS:
            raise QueryError(f"ways must be among {', '.join(WAYS)}, got {way!r}")
    given = {"seconds": seconds, "samples": samples, "seed": seed}
    line = results.command_line(NAME, data=data, table=table, columns=columns, objects=objects, ways=ways, **given)
    cells = select(data, columns or POINTS, None, objects, [Variant(Mlp.method)])
    if RECIPE.queries is not None and any(c.column.query not in RECIPE.queries for c in cells):
        raise QueryError(
            "columns must be of points, rays or boxes: networks of planes have neither recipe nor encoding"
        )
    folder = results.opened(Path(table) / NAME, NAME, CSV, DEFAULTS, given)
    left = missing(cells, folder, "way", chosen)
    if left:
        folder.remember(line)

    def measure(work: tuple[Cell, str]) -> str:
        folder.append(row := _measured(*work, folder.settings))
        return f"{row['steps']:,} steps in {row['fit_seconds']:.0f} s, {row['fp_rate']:.2f} % false positives"

    done = results.work(folder, left, measure, lambda work: f"{work[0].title} ({work[1]})")
    folder.write(results.PAGE, folder.page(NAME, section=section(Path(table))))
    whole = results.opened(Path(table), table1.NAME, table1.CSV, table1.DEFAULTS, {}, create=False)
    whole.write(results.PAGE, table1.page(whole))
    print(f"{len(folder.rows)} networks; the rows are in {Path(table) / results.PAGE}")
    return int(not done)


def steps_asked(recipe: str) -> int | None:
    """Steps that a recipe asks for at least: of the paper's, a first stage and those in which all must be well."""
    from warp_bounding.training.recipes.paper import PaperRecipe

    return None if recipe == RECIPES[0] else (1 + PaperRecipe().stable) * PaperRecipe().stage


def _measured(cell: Cell, way: str, s: dict[str, Any]) -> dict[str, Any]:
    from paper.proofs import Thresholds
    from warp_bounding.training import fit

    query, (recipe, octaves) = cell.column.kind, WAYS[way]
    options = {"length": s["length"]} if query.has_length else {}
    options |= {"hidden": cell.column.hidden, "recipe": recipe, "octaves": octaves, "device": "cpu"}
    bounder = results.finished(fit(cell.grid, query.name, Mlp.method, budget=s["seconds"], seed=s["seed"], **options))
    record = bounder.info["training"]
    if not record["steps"]:
        raise BounderError(f"not a single step in {s['seconds']:g} s; give it more")
    rates, threshold = Thresholds.of(bounder, cell.grid, s["samples"], s["seed"] + 1), float(bounder.threshold)
    proof = float(bounder.certificate.seconds) if bounder.certificate else 0.0
    trained = record["seconds"] - record.get("compile_seconds", 0.0) - proof
    return about(cell, bounder, s) | {
        "way": way,
        "steps": int(record["steps"]),
        "steps_asked": steps_asked(recipe),
        "step_seconds": max(trained, 0.0) / record["steps"],
        "fp_rate": rates.fp(threshold),
        "fn": rates.fn(threshold),
        "fp_zero": rates.fp(0.0),
        "fn_zero": rates.fn(0.0),
        "positives": 100 * float(rates.truth.mean()),
        "fit_seconds": round(record["seconds"], 3),
        "seconds": s["seconds"],
    }


def section(table: Path) -> list[str]:
    """What pages say of the rows in a folder of ``table1``, in Markdown; nothing where there are none."""
    file = table / NAME / f"{NAME}.csv"
    rows = results.read_rows(file, CSV)
    if not rows:
        return []
    order = list(WAYS)
    rows = sorted(rows, key=lambda r: (COLUMNS.index(column_of(r)), r["object"], order.index(r["way"])))
    heads = "|object|training|steps|of at least|which take|FP %, threshold proven"
    heads += "|FP % at 0.5|FN % at 0.5|paper's mean FP %"
    text = (Path(__file__).parent / "pages" / "recipes_section.md").read_text()
    for name in ("seconds", "threads"):
        text = text.replace(f"{{{name}}}", " or ".join(sorted({f"{r[name]:g}" for r in rows})))
    return [*text.splitlines(), *markdown(heads.split("|"), [_line(r) for r in rows], 3)]


def _line(row: dict[str, Any]) -> tuple[str, ...]:
    sign = {"proven": "", "": "<sup>u</sup>"}.get(row["certificate"], "<sup>s</sup>")
    column, steps = column_of(row), row["steps_asked"]
    minutes = (steps or 0) * row["step_seconds"] / 60
    time = f"{minutes / 60:.1f} h" if minutes >= 57 else f"{minutes:.0f} min"
    queried = ("–", "–") if steps is None else (f"{steps:,}", time)
    rates = (f"{row['fp_rate']:.2f}{sign}", f"{row['fp_zero']:.2f}", f"{100 * row['fn_zero'] / row['samples']:.3f}")
    names = (column.title, row["object"], row["way"], f"{row['steps']:,}")
    return *names, *queried, *rates, f"{Variant('mlp').paper(column):g}"
