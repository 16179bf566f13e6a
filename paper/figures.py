"""``python -m paper figures``: the paper's figures, computed and drawn; resumable at any moment.

A figure (``gallery.py``) is computed part by part; what a part returns is JSON, kept at once in the figure's file and
not computed again. Its pictures are drawn from that alone, and README.md shows them with captions and what was
measured.
"""

import contextlib
import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from paper import results
from paper.data import PATTERNS, Object, grid_of, own_shape
from paper.drawing import packed, raster
from warp_bounding.cli import count, number_option, quiet_warp
from warp_bounding.errors import BounderError, BoundingError, FileFormatError, ShapeError

NAME, FORMAT, DIGEST = "figures", 1, 16
PAPER, OWN = "paper", "own"  # whose objects are shown: those of the paper's data, or our own (``data.py``)
DEFAULTS = {"objects": OWN, "quick": False, "effort": 1.0, "samples": 200_000, "seed": 0}
OWN_UP, PAPER_UP = [0, 1, 0], [0, 0, 1]  # which way is up in pictures, but for:
OTHER_UPS = {"3d/armchair": [0, -1, 0], "3d/car": [0, -1, 0], "3d/sofa": [0, -1, 0], "3d/teddy": [0, 1, 0]}

Parts = Mapping[str, dict[str, Any]]


class Figure:
    """One figure: what it computes, part by part, and how that is drawn; its caption is in ``pages/figures.md``.

    Attributes:
        name: As the command line takes it, and its files are called.
        objects: Which of the paper's objects it shows, such as ``2d/star1``, with our own in their place, or ``None``.
        few: How many of them in the quick form; ``None`` for all.
    """

    name: str
    objects: Mapping[str, str | None] = {}
    few: int | None = None

    def wanted(self, settings: dict[str, Any]) -> list[str]:
        """The objects that it shows under these settings."""
        own = [label for label, stand_in in self.objects.items() if stand_in]
        found = list(self.objects) if settings["objects"] == PAPER or not own else own
        return found[: self.few] if settings["quick"] else found

    def parts(self, work: "Work") -> dict[str, Callable[[], dict[str, Any]]]:
        """What is computed, in this order: functions that return JSON, called where their results are missing."""
        raise NotImplementedError

    def draw(self, parts: Parts) -> dict[str, bytes]:
        """The pictures, by file ending (``png``, ``svg``), from what the parts returned."""
        raise NotImplementedError

    def facts(self, parts: Parts) -> list[str]:
        """Sentences with what was measured, for the page."""
        return []

    def broken(self, parts: Parts) -> list[str]:
        """Parts that break a promise: a bounder with a certificate and false negatives."""
        broken = {name: part["fn"] for name, part in parts.items() if part.get("certificate") and part.get("fn")}
        return [f"{name}: {fn:,} false negatives" for name, fn in broken.items()]


@dataclass
class Work:
    """What parts are computed with: ``settings`` of the folder, and the ``data`` folder, if one was given."""

    settings: dict[str, Any]
    data: Path | None = None
    stand_ins: dict[str, str | None] = field(default_factory=dict)  # of the figure at work

    def choose(self, full: Any, quick: Any) -> Any:
        """One of two values, by whether small forms are wanted."""
        return quick if self.settings["quick"] else full

    def file(self, label: str) -> Path | None:
        """Where an object of the paper lies."""
        return self.data and self.data / PATTERNS[int(label[0])].replace("*", label[3:])

    def lacking(self, figure: Figure) -> str | None:
        """In one line, what of the paper's data a figure needs and lacks; ``None`` if there is nothing."""
        theirs = self.settings["objects"] == PAPER
        there = {
            label: self.file(label) and self.file(label).is_file() if theirs else own
            for label, own in figure.objects.items()
        }
        absent = [label for label in figure.wanted(self.settings) if not there[label]]
        few = ", ".join(absent[:4]) + (f" and {len(absent) - 4} more" if len(absent) > 4 else "")
        if absent and theirs and self.data:
            return f"{figure.name} needs {few}, not in {self.data}"
        return f"{figure.name} shows the paper's objects ({few}): --data DIR is needed" if absent else None

    def shape(self, label: str) -> Any:
        """An object's cells."""
        if self.settings["objects"] != PAPER:
            return own_shape(self.stand_ins[label])
        if self.data is None:
            raise ShapeError(f"{label} of the paper's data is missing")
        return grid_of(Object(int(label[0]), label[3:], self.file(label)))

    def up(self, label: str) -> list[int]:
        """The direction that is up in pictures of an object in space."""
        return OTHER_UPS.get(label, PAPER_UP) if self.settings["objects"] == PAPER else OWN_UP

    def shown(self, label: str, points: np.ndarray) -> dict[str, Any]:
        """A part: where an object is, and which way is up."""
        return {"inside": packed(self.shape(label), points), "up": self.up(label)}

    def raster_parts(
        self, label: str, side: int, fits: Mapping[str, tuple[float, dict[str, Any]]], name: str = ""
    ) -> dict:
        """Parts of an object on a raster: itself, and bounders of it, each with its seconds and options."""
        grid, name = self.shape(label), name or label
        points = raster(grid, side)
        found = {
            f"{name} {what}": partial(self.measured, grid, *own[:1], points, **own[1]) for what, own in fits.items()
        }
        return {name: partial(self.shown, label, points)} | found

    def fit(self, shape: Any, seconds: float, query: str = "point", **options: Any) -> Any:
        """``warp_bounding.fit`` with the folder's seed and effort; this imports torch."""
        from warp_bounding.training import fit

        about = {"query": query, "budget": seconds * self.settings["effort"], "seed": self.settings["seed"]}
        bounder = fit(shape, device="cpu", **about, **options)
        results.heed()
        return bounder

    def measured(self, shape: Any, seconds: float, points: np.ndarray | None = None, **options: Any) -> dict[str, Any]:
        """``rates`` of a ``fit`` with these options; with points, what it answers there, packed, as ``"maybe"``."""
        bounder = self.fit(shape, seconds, **options)
        found = self.rates(bounder, shape)
        return found if points is None else found | {"maybe": packed(bounder, points)}

    def rates(self, bounder: Any, shape: Any) -> dict[str, Any]:
        """False positives, in per cent of random queries, false negatives, a count, and what the bounder is."""
        from warp_bounding.evaluation import evaluate

        found = evaluate(bounder, shape, self.settings["samples"], seed=self.settings["seed"] + 1)
        results.heed()
        return {
            "fp": round(float(found.fp_rate), 4),
            "fn": int(found.fn),
            "positives": round(float(found.positives), 4),
            "samples": int(found.samples),
            "certificate": bounder.certificate.kind if bounder.certificate else "",
            "nbytes": int(bounder.nbytes),
            "numbers": int(sum(np.size(t) for t in bounder.tensors.values())),
        }


def command(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Which figure, or all.")],
    quick: Annotated[bool, typer.Option("--quick", help="Small forms, all in some minutes.")] = False,
    data: Annotated[
        str | None, typer.Option(help="Folder of the paper's objects. Without it, our own are shown.")
    ] = None,
    out: Annotated[
        str, typer.Option("--output", "-o", help="Folder; an earlier run there is continued.")
    ] = "out/figures",
    effort: Annotated[float | None, typer.Option(help="Multiplies the seconds of every fit (default: 1)")] = None,
    samples: Annotated[int | None, number_option("Random queries for rates (default: 2e5)", count)] = None,
    seed: Annotated[int | None, number_option("Random seed of the fits (default: 0)")] = None,
) -> int:
    """Make a figure of the paper, or all of them, with captions and numbers in README.md.

    Kill it whenever you like: the same command goes on where it stopped, and draws anew what is there. Exit status 1: a
    figure failed, a promise was found broken, or the run was stopped.
    """
    from paper.gallery import FIGURES

    quiet_warp()
    if data is not None and not Path(data).is_dir():
        raise BoundingError(f"{data}: no such folder; it must hold {', '.join(PATTERNS.values())}")
    given = {"quick": quick, "objects": PAPER if data else OWN, "effort": effort, "samples": samples, "seed": seed}
    work = Work(DEFAULTS | {k: v for k, v in given.items() if v is not None}, None if data is None else Path(data))
    skipped = [line for figure in FIGURES if (line := work.lacking(figure))] if name == "all" else []
    chosen = [f for f in FIGURES if name in (f.name, "all") and not (name == "all" and work.lacking(f))]
    if not chosen:
        raise BounderError(f"figure must be one of {', '.join(f.name for f in FIGURES)}, or all, got {name!r}")
    if line := work.lacking(chosen[0]):
        raise ShapeError(line)
    for line in skipped:
        results.say(f"skipped: {line}")
    files = [f"{figure.name}.{ending}" for figure in FIGURES for ending in ("json", "png", "svg")]
    line = results.command_line(
        f"{NAME} {name}", data=data, out=out, effort=effort, samples=samples, seed=seed, quick=quick
    )
    broken: list[str] = []
    with results.opened(Path(out), NAME, (), DEFAULTS, given, owned=files) as folder:
        work.settings = folder.settings
        for figure in chosen:
            read(folder, figure)  # before any work
        folder.remember(line)

        def measure(figure: Figure) -> str:
            parts = computed(folder, figure, work)
            for ending, content in figure.draw(parts).items():
                folder.write(f"{figure.name}.{ending}", content)
            broken.extend(f"{figure.name}, {reported}" for reported in figure.broken(parts))
            return "drawn"

        done = results.work(folder, chosen, measure, lambda figure: figure.name)
        folder.write(results.PAGE, page(folder, FIGURES))
    for line in broken:
        results.say(f"promise broken: {line}")
    print(f"the figures are shown in {Path(out) / results.PAGE}")
    return int(bool(broken or not done))


def read(folder: results.Folder, figure: Figure) -> dict[str, Any]:
    """What a figure has computed so far: ``parts`` by name, ``objects`` (digests by label), ``versions``.

    Raises:
        FileFormatError: If it is damaged, or of other settings than the folder.
    """
    file = folder.path / f"{figure.name}.json"
    if not file.exists():
        return {"parts": {}, "objects": {}, "versions": []}
    try:
        document = json.loads(file.read_text())
        settings, found = document["settings"], {key: document[key] for key in ("parts", "objects", "versions")}
        sound = document["format"] == FORMAT and all(isinstance(part, dict) for part in found["parts"].values())
        same = all(settings.get(key, default) == folder.settings[key] for key, default in DEFAULTS.items())
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        sound = same = False
    if not (sound and same):
        what = "made with other settings than the folder's" if sound else "damaged, or not a figure of this version"
        raise FileFormatError(f"{file}: {what}; delete it and it is computed again")
    return found


def computed(folder: results.Folder, figure: Figure, work: Work) -> dict[str, Any]:
    """All parts; those that are there already are not computed again."""
    found, work.stand_ins = read(folder, figure), dict(figure.objects)
    digests = {label: work.shape(label).digest[:DIGEST] for label in figure.wanted(work.settings)}
    if other := [label for label, digest in found["objects"].items() if digests.get(label, digest) != digest]:
        raise ShapeError(f"{', '.join(other)}: not what {figure.name}.json was made of; choose another --output")
    parts = figure.parts(work)
    for number, (name, compute) in enumerate(parts.items(), start=1):
        if name in found["parts"]:
            continue
        results.say(f"{figure.name} {number}/{len(parts)}: {name}")
        started, value = time.perf_counter(), compute()
        results.heed()
        found["parts"][name] = {**value, "seconds": round(time.perf_counter() - started, 2)}
        found["objects"] |= digests
        found["versions"] = sorted({*found["versions"], results.versions()})
        document = {"format": FORMAT, "figure": figure.name, "settings": folder.settings, **found}
        folder.write(f"{figure.name}.json", json.dumps(document, indent=1, allow_nan=False) + "\n")
    return {name: found["parts"][name] for name in parts}


def page(folder: results.Folder, figures: tuple[Figure, ...]) -> str:
    """Every figure that is there, with its caption and what was measured."""
    s, values = folder.settings, {}
    for figure in figures:
        found, facts = read(folder, figure), []
        with contextlib.suppress(KeyError):  # parts of a run that has not ended
            facts = figure.facts(found["parts"]) if found["parts"] else []
        seconds = sum(part.get("seconds", 0.0) for part in found["parts"].values())
        made = (
            f"Computed in {seconds:,.0f} s by {'; '.join(found['versions'])}; numbers: "
            f"[{figure.name}.json]({figure.name}.json)."
        )
        values[figure.name] = [f"- {fact}" for fact in [*facts, made]]
    forms = ["the quick forms (`--quick`)"] if s["quick"] else []
    forms += [f"every fit for {s['effort']:g} times its usual seconds"] if s["effort"] != 1 else []
    whose = (
        "the paper's objects" if s["objects"] == PAPER else "shapes of our own, since the paper's data was not given"
    )
    text = folder.page(NAME, whose=whose, forms=f" In {' and '.join(forms)}." if forms else "", **values)
    head, *sections = text.split("\n## ")
    there = [part for part in sections if (folder.path / part.partition("](")[2].partition(")")[0]).is_file()]
    return "\n## ".join([head, *there])
