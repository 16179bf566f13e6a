"""``python -m paper figures``: the paper's figures, computed and drawn; resumable at any moment.

A figure (``gallery.py``) is computed part by part; what a part returns is JSON, kept at once in the figure's file and
not computed again. Its pictures are drawn from that alone, and README.md shows them with captions and what was
measured.
"""

import json
import time
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from paper import results
from paper.data import PATTERNS, Object, grid_of
from paper.drawing import packed, raster
from paper.gallery import FIGURES
from sims.versions import versions
from warp_bounding.errors import BounderError, BoundingError, FileFormatError, ShapeError

NAME, FORMAT, DIGEST = "figures", 1, 16
DEFAULTS = {"objects": "paper", "quick": False, "effort": 1.0, "samples": 200_000, "seed": 0}
UP = [0, 0, 1]  # in pictures, but for:
OTHER_UPS = {"3d/armchair": [0, -1, 0], "3d/car": [0, -1, 0], "3d/sofa": [0, -1, 0], "3d/teddy": [0, 1, 0]}


class Work:
    """What parts are computed with: ``settings`` of the folder, and the ``data`` folder, if one was given."""

    def __init__(self, settings: dict[str, Any], data: Path | None):
        self.settings, self.data = settings, data

    def choose(self, full: Any, quick: Any) -> Any:
        """One of two values, by whether small forms are wanted."""
        return quick if self.settings["quick"] else full

    def labels(self, figure) -> list[str]:
        """The objects that a figure shows."""
        return list(figure.objects)[: self.choose(None, figure.few)]

    def shape(self, label: str) -> Any:
        """An object's cells."""
        if self.data is None:
            raise ShapeError(f"{label} is an object of the paper: --data DIR is needed")
        return grid_of(Object(int(label[0]), label[3:], self.data / PATTERNS[int(label[0])].replace("*", label[3:])))

    def place(self, grid: Any, side: int, frame: int | None) -> np.ndarray:
        """A raster over an object's domain, of an animated one at a step of time."""
        return raster(grid, side, None if frame is None else float(grid.position([frame, 0, 0, 0])[0]))

    def shown(self, label: str, side: int, frame: int | None = None, occupied: bool = False) -> dict[str, Any]:
        """A part: where an object is, and which way is up; and how much it occupies, if wanted."""
        grid = self.shape(label)
        share = {"occupied": round(100 * float(grid.occupancy.mean()), 2)} if occupied else {}
        return {"inside": packed(grid, self.place(grid, side, frame)), "up": OTHER_UPS.get(label, UP)} | share

    def around(self, label: str, side: int, fits: dict[str, tuple[float, dict[str, Any]]], name: str = "") -> dict:
        """Parts of an object on a raster: itself, and bounders of it, each with its seconds and options."""
        name = name or label
        found = {
            f"{name} {what}": partial(self.measured, label, seconds, side, **own)
            for what, (seconds, own) in fits.items()
        }
        return {name: partial(self.shown, label, side)} | found

    def fit(self, shape: Any, seconds: float, query: str = "point", **options: Any) -> Any:
        """``warp_bounding.fit`` with the folder's seed and effort; this imports torch."""
        from warp_bounding.training import fit

        about = {"query": query, "budget": seconds * self.settings["effort"], "seed": self.settings["seed"]}
        return results.finished(fit(shape, device="cpu", **about, **options))

    def measured(self, label: str, seconds: float, pixels: int = 0, frame: int | None = None, **options: Any) -> dict:
        """A part: ``rates`` of a ``fit`` with these options, and what it answers on a raster, as ``"maybe"``."""
        grid = self.shape(label)
        bounder = self.fit(grid, seconds, **options)
        found = self.rates(bounder, grid)
        return found | {"maybe": packed(bounder, self.place(grid, pixels, frame))} if pixels else found

    def rates(self, bounder: Any, shape: Any) -> dict[str, Any]:
        """False positives, in per cent of random queries, false negatives, a count, and what the bounder is."""
        from warp_bounding.evaluation import evaluate

        found = evaluate(bounder, shape, self.settings["samples"], seed=self.settings["seed"] + 1)
        rates = {
            "fp": round(float(found.fp_rate), 4),
            "fn": int(found.fn),
            "positives": round(float(found.positives), 4),
        }
        rates |= {"samples": int(found.samples), "nbytes": int(bounder.nbytes)}
        rates |= {"certificate": bounder.certificate.kind if bounder.certificate else ""}
        return rates | {"numbers": int(sum(np.size(t) for t in bounder.tensors.values()))}


def run(line, name, output="out/figures", data=None, quick=False, effort=None, samples=None, seed=None) -> int:
    """Make a figure of the paper, or all of them, with captions and numbers in README.md."""
    if data is not None and not Path(data).is_dir():
        raise BoundingError(f"{data}: no such folder; it must hold {', '.join(PATTERNS.values())}")
    if name != "all" and name not in FIGURES:
        raise BounderError(f"figure must be one of {', '.join(FIGURES)}, or all, got {name!r}")
    given = {"quick": quick or None, "effort": effort, "samples": samples, "seed": seed}
    broken: list[str] = []
    folder = results.opened(Path(output), NAME, (), DEFAULTS, given)
    work = Work(folder.settings, None if data is None else Path(data))
    folder.remember(line)

    def measure(name: str) -> str:
        parts = computed(folder, name, work)
        for ending, content in FIGURES[name].draw(parts).items():
            folder.write(f"{name}.{ending}", content)
        broken.extend(f"{name}, {part}: {missed:,} missed" for part, missed in missed_of(parts))
        return "drawn"

    done = results.work(folder, list(FIGURES) if name == "all" else [name], measure, str)
    folder.write(results.PAGE, page(folder))
    for line in broken:
        results.say(f"promise broken: {line}")
    print(f"the figures are shown in {Path(output) / results.PAGE}")
    return int(bool(broken or not done))


def computed(folder: results.Folder, name: str, work: Work) -> dict[str, Any]:
    """All parts; those that are there already are not computed again."""
    found, labels = read(folder, name), work.labels(FIGURES[name])
    parts = FIGURES[name].parts(work, labels)
    left = [part for part in parts if part not in found["parts"]]
    digests = {label: work.shape(label).digest[:DIGEST] for label in labels} if left else {}
    for part in left:
        results.say(f"{name} {list(parts).index(part) + 1}/{len(parts)}: {part}")
        started, value = time.perf_counter(), parts[part]()
        found["parts"][part] = {**value, "seconds": round(time.perf_counter() - started, 2)}
        found["objects"] |= digests
        found["versions"] = sorted({*found["versions"], versions()})
        document = {"format": FORMAT, "figure": name, "settings": folder.settings, **found}
        folder.write(f"{name}.json", json.dumps(document, indent=1, allow_nan=False) + "\n")
    return {part: found["parts"][part] for part in parts}


def read(folder: results.Folder, name: str) -> dict[str, Any]:
    """What a figure has computed so far: ``parts`` by name, ``objects`` (digests by label), ``versions``."""
    file = folder.path / f"{name}.json"
    if not file.exists():
        return {"parts": {}, "objects": {}, "versions": []}
    document = json.loads(file.read_text())
    if any(document["settings"].get(key, old) != folder.settings[key] for key, old in DEFAULTS.items()):
        raise FileFormatError(f"{file}: made with other settings than the folder's")
    return {key: document[key] for key in ("parts", "objects", "versions")}


def missed_of(parts: dict[str, Any]) -> list[tuple[str, int]]:
    """Parts, and parts of parts, that break a promise: a certificate, and something that was missed or differs."""
    found = []
    for name, part in parts.items():
        runs = {f"{name} {run['section'] or ''} {run['bounder']}": run for run in part.get("runs", ())}
        found += missed_of(part.get("levels", {}) | runs)
        missed = part.get("fn", part.get("missed")) or int(part.get("identical") is False)
        if part.get("certificate") in ("proven", "statistical") and isinstance(missed, int) and missed:
            found.append((name, missed))
    return found


def facts(parts: dict[str, Any], means: bool = False) -> list[str]:
    """What was measured, a few words a part; or means over the objects, and how many were missed, with ``means``."""

    def dimension(item) -> str:
        return item[0][:2] if item[0][0].isdigit() else ""

    lines, rates, missed = [], {}, Counter()
    for name, part in parts.items():
        if "runs" in part:
            lines += [told(name, run) for run in part["runs"] if run["bounder"] in ("mlp", "occupancy")]
        elif "levels" in part:
            lines += facts(part["levels"])
        elif "fp" in part and means:
            label, _, bounder = name.partition(" ")
            place = f"{label.partition('/')[0]} {bounder}" if "/" in label else bounder
            rates.setdefault(place, []).append(part["fp"])
            missed[place] += part["fn"]
        elif "fp" in part:
            rate, denied = (part[key][-1] if isinstance(part[key], list) else part[key] for key in ("fp", "fn"))
            counted = f"{denied:,}" if isinstance(denied, int) else f"{denied:.3f} %"
            lines.append(f"{name} {rate:.2f} %" + (f", FN {counted}" if denied else ""))
        elif "occupied" in part:
            lines.append(f"{name} {part['occupied']:g} % occupied")
    found = [
        f"{name} {np.mean(own):.2f} %" + f", FN {missed[name]:,}" * bool(missed[name])
        for name, own in sorted(rates.items(), key=dimension)
    ]
    return lines + ([f"means over the objects: {'; '.join(found)}"] if found else [])


def told(name: str, run: dict[str, Any]) -> str:
    """A run of a demo."""
    words = f"{name} {run['section'] or ''} `{run['bounder']}` missed {run['missed']:,}".replace("  ", " ")
    if run.get("asked") is None or run["bounder"] != "mlp":
        return words
    cost = f"the decoder is run for {run['asked']:.0f} % of the pixels, {run['faster']:.1f} times as fast"
    return f"{words} ({run['certificate']}; false positives {run['fp_rate']:.1f} %; {cost})"


def page(folder: results.Folder) -> str:
    """Every figure that is there, with its caption and what was measured."""
    s, values = folder.settings, {}
    for name in FIGURES:
        found = read(folder, name)
        seconds = sum(part.get("seconds", 0.0) for part in found["parts"].values())
        made = f"Computed in {seconds:,.0f} s by {'; '.join(found['versions'])}; numbers: [{name}.json]({name}.json)."
        values[name] = [f"- {line}" for line in ("; ".join(facts(found["parts"], FIGURES[name].means)) + ".", made)]
    versions = {each.split(" (")[0] for name in FIGURES for each in read(folder, name)["versions"]}
    values["made_with"] = " and ".join(sorted(versions)) or "nothing yet"
    forms = ["the quick forms (`--quick`)"] if s["quick"] else []
    forms += [f"every fit for {s['effort']:g} times its usual seconds"] if s["effort"] != 1 else []
    text = folder.page(NAME, forms=f" In {' and '.join(forms)}." if forms else "", **values)
    head, *sections = text.split("\n## ")
    there = [part for part in sections if (folder.path / part.partition("](")[2].partition(")")[0]).is_file()]
    return "\n## ".join([head, *there])
