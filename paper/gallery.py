"""The paper's figures: what each computes, part by part, and how it is drawn from that alone.

A figure is two functions and a line in ``FIGURES`` at the end; its caption is a section of ``pages/figures.md``. The
first one is given ``figures.Work`` and the labels of its objects, and returns functions by the names of parts; what
they return is JSON. The second one is given these parts, and returns files by their ending.
"""

import base64
import tempfile
from collections.abc import Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import numpy as np

from paper import drawing as d
from paper.drawing import TINTS, Panel, layer, numbered, pack, packed, raster, scene, unpack
from paper.results import finished
from warp_bounding.activations import DEFAULT
from warp_bounding.errors import BoundingError
from warp_bounding.queries import sample
from warp_bounding.shapes import Grid
from warp_bounding.shapes.complement import SIDES


def labels_of(parts) -> list[str]:
    """Names of the parts that are objects; others are measured."""
    return [name for name, part in parts.items() if "inside" in part]


def flat(thing, part, tint: str, title: str = "", side: str = "") -> Panel:
    """A panel of an object in 2D with what a bounder adds to it and denies of it, and its rates."""
    return Panel(d.bounded(unpack(thing["inside"]), unpack(part["maybe"]), tint), title, numbered(part), side=side)


def solid(thing, part, tint: str, *, glass: bool, near: bool):
    """A scene of an object in 3D: with a bound around it, and in red what that denies; ``near``: it fills the view."""
    inside, layers = thing["inside"], []
    if part is not None:
        denied = d.pack(unpack(inside) & ~unpack(part["maybe"]))
        layers = [layer(denied, d.DENIED), layer(part["maybe"], tint, 0.45 if glass else 1.0, smooth=True)]
    body = [layer(inside, d.SOLID if part is not None else tint)] if glass or part is None else []
    return scene(*body, *layers, up=thing["up"], around=inside if near else None)


def hidden(name: str) -> tuple[int, ...]:
    """Widths, of ``20-10-5``."""
    return tuple(map(int, name.split("-")))


# --- teaser: classic volumes and networks around one 2D object, and growing networks in two, three and four dimensions

SMALL = {"hidden": (20, 10, 5)}
CLASSIC = {"aabb": {}, "ellipsoid": {}, "kdop": {}, "occupancy": SMALL, "mlp": SMALL}
GROWING = {  # by dimension: networks, seconds in full and quick, and a raster's side
    2: (("4", "10", "20-10-5", "50-50"), (15, 2), 256),
    3: (("4", "10-10", "25-25", "50-50"), (40, 4), 72),
    4: (("4", "10-10", "25-25", "75-75"), (90, 8), 72),
}
FRAME = 2  # the step of time that is shown


def teaser_parts(work, labels):
    parts = {}
    for label, (ndim, (sizes, seconds, side)) in zip(labels, GROWING.items(), strict=True):
        frame = FRAME if ndim == 4 else None
        fits = CLASSIC if ndim == 2 else {}
        fits = {name: {"method": name, **own} for name, own in fits.items()}
        fits |= {name: {"method": "mlp", "hidden": hidden(name)} for name in sizes}
        parts[f"{ndim}d object"] = partial(work.shown, label, side, frame)
        for name, own in fits.items():
            parts[f"{ndim}d {name}"] = partial(work.measured, label, work.choose(*seconds), side, frame, **own)
    return parts


def teaser(parts):
    thing, scenes = parts["2d object"], {}
    rows = [[flat(thing, parts[f"2d {method}"], TINTS[method], method) for method in CLASSIC]]
    for ndim in (3, 4):
        for name in ("object", *GROWING[ndim][0]):
            part = parts[f"{ndim}d {name}"] if name != "object" else None
            tint = d.SOLID if part is None else TINTS["mlp"]
            scenes[f"{ndim}d {name}"] = solid(parts[f"{ndim}d object"], part, tint, glass=True, near=False)
    pictures = d.images(scenes)
    for ndim, (sizes, *_) in GROWING.items():
        first = pictures[f"{ndim}d object"] if ndim > 2 else d.tinted({d.OBJECT: unpack(thing["inside"])})
        row = [Panel(first, "object", side=f"{ndim}D")]
        for name in sizes:
            part, title = parts[f"{ndim}d {name}"], f"{ndim}-{name}-1"
            image = pictures.get(f"{ndim}d {name}")
            row.append(flat(thing, part, TINTS["mlp"], title) if ndim == 2 else Panel(image, title, numbered(part)))
        rows.append(row)
    return d.grid(rows, svg=False)


# --- progressive: one object, bounded by wider and wider networks

SIZES = {"5-5": 10, "10-10": 15, "10-10-5": 20, "25-25-5": 30, "50-50": 40, "128-128-128": 120}  # seconds
QUICK_SIZES = {"5-5": 2, "10-10-5": 3, "25-25-5": 4, "50-50": 5}


def progressive_parts(work, labels):
    parts = {"object": partial(work.shown, labels[0], 256)}
    for name, seconds in work.choose(SIZES, QUICK_SIZES).items():
        parts[name] = partial(work.measured, labels[0], seconds, 256, method="mlp", hidden=hidden(name))
    return parts


def progressive(parts):
    sizes = {name: part for name, part in parts.items() if "fp" in part}

    def plot(axes) -> None:
        numbers, rates = ([part[key] for part in sizes.values()] for key in ("numbers", "fp"))
        axes.plot(numbers, rates, "o-", color=TINTS["mlp"])
        axes.set(xscale="log", ylim=(0, None), xlabel="parameters", title="false positives, %", box_aspect=1)
        axes.spines[["top", "right"]].set_visible(False)

    return d.grid([[*(flat(parts["object"], part, TINTS["mlp"], name) for name, part in sizes.items()), plot]])


# --- gallery: 3D shapes by methods, with what is cut off in red

SECONDS = {"aabb": (60, 60), "kdop": (60, 60), "learned-kdop": (10, 4), "occupancy": (15, 6), "mlp": (60, 10)}


def gallery_parts(work, labels):
    fits = {method: (work.choose(*seconds), {"method": method}) for method, seconds in SECONDS.items()}
    return {k: v for label in labels for k, v in work.around(label, 80, fits, label[3:]).items()}


def gallery(parts):
    names = {row: [row, *(f"{row} {method}" for method in SECONDS)] for row in labels_of(parts)}
    scenes, titles = {}, ("object", *SECONDS)
    for row, own in names.items():
        for name, method in zip(own, ("", *SECONDS), strict=True):
            part, tint = (parts[name], TINTS[method]) if method else (None, d.SOLID)
            scenes[name] = solid(parts[row], part, tint, glass=False, near=True)
    pictures, rows = d.images(scenes), []
    for own in names.values():
        below = ["", *(numbered(parts[name]) for name in own[1:])]
        shown = zip(own, titles, below, strict=True)
        rows.append([Panel(pictures[name], title if not rows else "", text, False) for name, title, text in shown])
    return d.grid(rows, svg=False)


# --- objects: the sheet of everything that the paper bounds

SHEET = {"2": (128, d.OBJECT), "3": (64, "#8fa7bf"), "4": (64, "#c9a27c")}  # by dimension: a raster's side, the tint
FRAMES = (0, 3, 6)


def objects_parts(work, labels):
    parts = {}
    for label in labels:
        for frame in FRAMES if label[0] == "4" else (None,):
            name = label if frame is None else f"{label}, step {frame + 1}"
            parts[name] = partial(work.shown, label, SHEET[label[0]][0], frame, occupied=True)
    return parts


def objects(parts):
    near = {name: name[0] == "3" for name in parts if name[0] != "2"}  # an animated one keeps its size
    scenes = {n: solid(parts[n], None, SHEET[n[0]][1], glass=False, near=own) for n, own in near.items()}
    pictures = d.images(scenes)
    pictures |= {n: d.tinted({d.OBJECT: unpack(p["inside"])}) for n, p in parts.items() if n not in pictures}
    rows = [[Panel(pictures[n], n[3:]) for n in parts if n[0] == ndim] for ndim in SHEET]
    return d.grid([row for row in rows if row], svg=False, inch=1.15)


# --- kdop: six half-spaces, with fixed normals and with learned ones, like for like

HALF_SPACES = {"kdop": "fixed normals (kdop)", "learned-kdop": "learned normals (learned-kdop)"}


def kdop_parts(work, labels):
    fits = {method: (work.choose(10, 3), {"method": method, "k": 6}) for method in HALF_SPACES}
    return {k: v for label in labels for k, v in work.around(label, 256, fits).items()}


def kdop(parts):
    rows = []
    for method, side in HALF_SPACES.items():
        row = [flat(parts[label], parts[f"{label} {method}"], TINTS[method]) for label in labels_of(parts)]
        rows.append([row[0]._replace(side=side), *row[1:]])
    return d.grid(rows)


# --- relu-fields: pixels, a field that is trained as a classifier, and ours, all of the same resolution

RASTER, NODES = 384, 12  # a raster's side, a multiple of the next: of all three along each axis
FIELDS = {  # title and tint
    "pixels": ("pixels", "voxels"),
    "plain": ("field, as a classifier", "occupancy"),
    "ours": ("field, ours (proven)", "relu-field"),
}


def relu_fields_parts(work, labels):
    (label,), s = labels, work.settings

    def measured(make) -> dict:
        """Rates of an answer to points, as ``Work.rates`` has them."""
        grid, rng = work.shape(label), np.random.default_rng(s["seed"] + 1)
        points, ask = raster(grid, RASTER), make(grid)
        x = rng.uniform(grid.sample_lower, grid.sample_upper, (s["samples"], grid.ndim)).astype(np.float32)
        truth, maybe = grid.contains(x.astype(np.float64)), ask(x.astype(np.float64))
        counts = {"fp": round(100 * float((maybe & ~truth).mean()), 4), "fn": int((~maybe & truth).sum())}
        shown = ask(points.reshape(-1, 2).astype(np.float64)).reshape(points.shape[:-1])
        return {**counts, "samples": len(x), "maybe": d.pack(shown)}

    def pixels(grid):
        marked = unpack(packed(grid, raster(grid, RASTER))).reshape(*(NODES, RASTER // NODES) * 2).any(axis=(1, 3))
        at = lambda x: np.floor((x - grid.lower) / (grid.upper - grid.lower) * NODES).astype(int)  # noqa: E731
        return lambda x: marked[tuple(at(x).clip(0, NODES - 1).T)]

    def plain(grid):
        from paper.comparisons import plain_field

        return plain_field(grid, NODES, s["seed"], 1500, 8192, 0.05)  # steps, batch, rate

    ours = partial(work.measured, label, work.choose(20, 4), RASTER, method="relu-field", nodes=NODES)
    parts = {"object": partial(work.shown, label, RASTER), "pixels": partial(measured, pixels)}
    return parts | {"plain": partial(measured, plain), "ours": ours}


def relu_fields(parts):
    return d.grid([[flat(parts["object"], parts[n], TINTS[tint], title) for n, (title, tint) in FIELDS.items()]])


# --- convergence: both errors over training, with the asymmetric loss and with the common one

TRAINED = {"2": ((25, 25), (8_000, 1_600)), "3": ((50, 50), (6_400, 1_200))}  # hidden; steps in full and quick
LOSSES = {"asymmetric": ("ours: asymmetric", "#1f6fb4"), "common": ("common: symmetric", "#d62b2b")}
LEAST = 0.003  # per cent; below, the axis is linear


def convergence_parts(work, labels):
    def trained(label: str, loss: str) -> dict:
        from paper.comparisons import record

        hidden, steps = TRAINED[label[0]]
        steps = max(8, round(work.choose(*steps) * work.settings["effort"]))
        sizes = {"steps": steps, "stage": steps // 8, "every": max(1, steps // 64), "batch": work.choose(4096, 2048)}
        own = {"common": loss == "common", "seed": work.settings["seed"], "note": lambda text: None}
        return {**record(work.shape(label), hidden, DEFAULT.name, **sizes, **own), "stage": sizes["stage"]}

    return {f"{label} {loss}": partial(trained, label, loss) for label in labels for loss in LOSSES}


def convergence(parts):
    def plot(label: str, axes) -> None:
        for loss, (reported, colour) in LOSSES.items():
            part = parts[f"{label} {loss}"]
            axes.plot(part["step"], part["fn"], color=colour, label=f"{reported}, false negatives")
            axes.plot(part["step"], part["fp"], ":", color=colour, label=f"{reported}, false positives")
        for step in range(part["stage"], part["step"][-1], part["stage"]):
            axes.axvline(step, color=d.PALE, linewidth=0.8, zorder=0)
        axes.set_yscale("symlog", linthresh=LEAST, linscale=0.4)
        axes.set_yticks([0, 0.01, 0.1, 1, 10, 100], ["0", "0.01", "0.1", "1", "10", "100"])
        axes.set(ylim=(-LEAST / 4, 100), xlim=(0, part["step"][-1]), xlabel="training steps", ylabel="% of points")
        axes.minorticks_off()
        axes.set_title(f"{label[0]}D {label[3:]}", loc="left", fontsize=10, fontweight="bold")
        axes.spines[["top", "right"]].set_visible(False)

    labels = list(dict.fromkeys(name.partition(" ")[0] for name in parts))
    return d.grid([[partial(plot, label) for label in labels]], inch=4.0, legend=True)


# --- complexity: false positives against the size of the network, by dimension

WIDTHS = {  # of both hidden layers, in full and quick, and seconds
    "2": ((10, 16, 25, 50, 75, 125), (10, 25), (10, 2)),
    "3": ((16, 25, 50, 75, 125), (16, 32), (30, 5)),
    "4": ((25, 50, 75), (16, 32), (60, 8)),
}
BASELINES, WIDE = {"obb": "-", "sphere": "--"}, 50  # neurons from which the seconds grow with the width


def complexity_parts(work, labels):
    parts = {}
    first = [next(label for label in labels if label[0] == ndim) for ndim in WIDTHS]
    for label in work.choose(labels, first):
        full, quick, seconds = WIDTHS[label[0]]
        for method in BASELINES:
            parts[f"{label} {method}"] = partial(work.measured, label, 60.0, method=method)
        for width in work.choose(full, quick):
            time = work.choose(*seconds) * max(1.0, width / WIDE)
            parts[f"{label} mlp {width}"] = partial(work.measured, label, time, method="mlp", hidden=(width, width))
    return parts


def complexity(parts):
    def plot(ndim: str, axes) -> None:
        found: dict[str, list] = {}  # of all objects, by method, or ``mlp`` and width
        for name, part in parts.items():
            if name[0] == ndim:
                found.setdefault(name.partition(" ")[2], []).append(part)
        networks = sorted((own[0]["numbers"], [p["fp"] for p in own]) for n, own in found.items() if n[:3] == "mlp")
        size, rates = [n for n, _ in networks], np.array([own for _, own in networks])
        axes.fill_between(size, rates.min(axis=1), rates.max(axis=1), color=TINTS["mlp"], alpha=0.25, linewidth=0)
        axes.plot(size, rates.mean(axis=1), "o-", color=TINTS["mlp"], label="mlp")
        for method, style in BASELINES.items():
            own = [p["fp"] for p in found[method]]
            axes.axhspan(min(own), max(own), color=TINTS[method], alpha=0.15, linewidth=0)
            axes.axhline(np.mean(own), color=TINTS[method], linestyle=style, label=method)
        axes.set(xscale="log", yscale="log", xlabel="parameters", ylim=(0.1, 100))
        axes.set_yticks([0.1, 0.3, 1, 3, 10, 30, 100], ["0.1", "0.3", "1", "3", "10", "30", "100"])
        axes.set_xticks(size, [f"{number:,}" for number in size], rotation=30)
        axes.minorticks_off()
        axes.grid(axis="y", color=d.PALE, linewidth=0.8)
        axes.spines[["top", "right"]].set_visible(False)
        axes.set_title(f"{ndim}D", loc="left", fontweight="bold", fontsize=10)
        axes.set_ylabel("false positives, % (log scale)" if ndim == "2" else "")

    return d.grid([[partial(plot, ndim) for ndim in WIDTHS]], inch=3.0, legend=True)


# --- hierarchy: a school of fish, in one network, networks of its parts, and both together

LEVELS = {  # hidden layers, and tints as in the paper
    "root": ((16, 16), "#5b9bd5"),
    "children": ((12, 12), "#f2c230"),
    "leaves": ((10, 10), "#e77fb3"),
}
TITLES = {
    "root": "one network", "children": "two children", "leaves": "four leaves", "together": "one and four together",
}  # fmt: skip
SCHOOL = (  # centres, lengths and angles of the fish, of which the upper ones swim a little downwards
    (0.14, 0.83, 0.17, -0.25), (0.33, 0.9, 0.15, -0.15), (0.29, 0.74, 0.19, -0.3), (0.49, 0.79, 0.16, -0.1),
    (0.46, 0.93, 0.12, -0.2), (0.66, 0.87, 0.15, -0.05), (0.83, 0.78, 0.17, 0.1), (0.65, 0.7, 0.13, 0.0),
    (0.2, 0.21, 0.18, 0.2), (0.4, 0.3, 0.15, 0.1), (0.39, 0.13, 0.16, 0.15), (0.59, 0.2, 0.19, 0.05),
    (0.78, 0.32, 0.15, -0.1), (0.8, 0.13, 0.14, 0.1), (0.6, 0.38, 0.11, 0.0), (0.91, 0.22, 0.11, 0.0),
)  # fmt: skip


def fish(points: np.ndarray, centre=(0.5, 0.5), size: float = 0.9, angle: float = 0.0) -> np.ndarray:
    """A fish that swims to the left, with a forked tail and two fins; ``size`` is its length, ``angle`` in radians."""
    d = (np.asarray(points, dtype=np.float64) - centre) / size
    c, s = np.cos(angle), np.sin(angle)
    x, y = c * d[..., 0] + s * d[..., 1], c * d[..., 1] - s * d[..., 0]
    t = np.clip((x + 0.5) / 0.82, 0, 1)
    body = (x > -0.5) & (x < 0.32) & (np.abs(y) < 0.17 * np.sin(np.pi * t**0.75) ** 0.9 + 0.03 * (t > 0.5))
    reach = np.clip((x - 0.22) / 0.28, 0, 1)
    tail = (x > 0.22) & (x < 0.5) & (np.abs(y) < 0.03 + 0.19 * reach**1.2) & (np.abs(y) > 0.34 * (reach - 0.5))
    back = (y > 0) & (y < 0.27 - 0.55 * np.abs(x + 0.02)) & (x > -0.2) & (x < 0.16)
    below = (y < 0) & (y > -0.26 + 1.1 * np.abs(x - 0.02)) & (np.abs(x - 0.02) < 0.12)
    return body | tail | back | below


def halved(cells: np.ndarray, axes: Sequence[int]) -> list[np.ndarray]:
    """Cells cut along each of the axes in turn, so that both sides have about as many of them."""
    if not axes:
        return [cells]
    at = np.indices(cells.shape)[axes[0]]
    below = at <= np.median(at[cells])
    return [part for side in (below, ~below) for part in halved(cells & side, axes[1:])]


def hierarchy_parts(work, labels):
    def levels() -> dict:
        from warp_bounding.training import fit

        at = np.stack(np.meshgrid(*[np.linspace(0, 1, 160)] * 2, indexing="ij"), axis=-1)
        cells = np.any([fish(at, (x, y), 1.25 * size, angle) for x, y, size, angle in SCHOOL], axis=0)
        grid, s = Grid(cells, name="school"), work.settings
        steps = max(1, round(work.choose(4000, 500) * s["effort"]))
        own, maybe = {"method": "mlp", "steps": steps, "seed": s["seed"], "device": "cpu"}, {}
        for depth, (level, (hidden, _)) in enumerate(LEVELS.items()):
            parts = [Grid(part, name="school") for part in halved(cells, (1, 0)[:depth])]
            networks = [finished(fit(part, hidden=hidden, **own)) for part in parts]
            maybe[level] = lambda x, networks=networks: np.any([n.query(x).numpy() for n in networks], axis=0)
        maybe["together"] = lambda x: maybe["root"](x) & maybe["leaves"](x)
        x = sample("point", grid, s["samples"], np.random.default_rng(s["seed"] + 1)).astype(np.float32)
        truth, points, found = grid.contains(x), raster(grid, 400), {}
        pixels = points.reshape(-1, 2)
        for name, test in maybe.items():
            answers = test(x)
            rates = {"fp": 100 * float((answers & ~truth).mean()), "fn": int((truth & ~answers).sum())}
            rates |= {"positives": 100 * float(truth.mean()), "samples": len(x), "certificate": "proven"}
            found[name] = rates | {"maybe": pack(test(pixels).reshape(points.shape[:2]))}
        return {"inside": packed(grid, points), "levels": found}

    return {"school": levels}


def hierarchy(parts):
    row, levels = [], parts["school"]["levels"]
    for name, title in TITLES.items():
        shown = [name] if name in LEVELS else ["root", "leaves"]
        layers = {LEVELS[each][1]: unpack(levels[each]["maybe"]) for each in shown}
        image = d.tinted(layers | {d.OBJECT: unpack(parts["school"]["inside"])})
        row.append(Panel(image, title, numbered(levels[name])))
    return d.grid([row], inch=2.5)


# --- inside-and-outside: where a point is certainly not in the object, and where it certainly is

NEVER, ALWAYS, WITHIN = "#a9cbe8", "#f2bd1d", "#6d8296"
SIDED = {"2": (256, (25, 25), (30, 6)), "3": (80, (50, 50), (90, 12))}  # a raster's side, hidden layers, seconds


def sides_parts(work, labels):
    parts = {}
    for label in labels:
        side, hidden, seconds = SIDED[label[0]]
        fits = {each: (work.choose(*seconds), {"method": "mlp", "hidden": hidden, "side": each}) for each in SIDES}
        parts |= work.around(label, side, fits, f"{label[0]}D-{label[3:]}")
    return parts


def sides(parts):
    masks, scenes, row = {}, {}, []
    for name in labels_of(parts):
        never, always = (~unpack(parts[f"{name} {side}"]["maybe"]) for side in SIDES)
        masks[name], body = (never, always), layer(d.pack(always), ALWAYS, smooth=True)
        glass = layer(parts[name]["inside"], d.SOLID, 0.35, smooth=True)
        if name[0] == "3":
            scenes[name] = scene(body, glass, up=parts[name]["up"], around=parts[name]["inside"])
    pictures = d.images(scenes)
    for name, (never, always) in masks.items():
        inside, image = unpack(parts[name]["inside"]), pictures.get(name)
        image = d.tinted({WITHIN: inside, NEVER: never, ALWAYS: always}) if image is None else image
        share = np.floor(1000 * (never | always).mean()) / 10  # what is not certain everywhere is not told to be
        row.append(Panel(image, name[3:], f"certain: {share:.1f} % of all", name not in pictures))
    return d.grid([row], svg=False, inch=2.4)


# --- digits, a generative model, bounded before it is run; and applications: four demos, with and without a proof

DEMOS = {  # the picture that a demo draws, the share of its height that is shown, and what is said of it
    "path": ("path.png", 0.482, "2D paths"),
    "cloth": ("cloth.png", 1.0, "cloth on a mesh"),
    "particles": ("rain.png", 1.0, "particles on a moving mesh"),
    "shadows": ("shadows.png", 1.0, "shadow rays"),
}


def run_demo(name: str, file: str, quick: bool, width: int | None = None) -> dict:
    """A part: what a demo of ``sims`` told of its runs, and its picture; its text goes to standard error."""
    from sims.report import output

    with tempfile.TemporaryDirectory() as folder:
        demo = import_module(f"sims.{name}")
        reported = demo.run(Path(folder), quick=quick, seed=0, device="cpu", console=output(stderr=True))
        path = Path(folder) / file
        if not path.is_file():
            raise BoundingError(f"the demo {name} drew nothing: off-screen drawing needs OpenGL (libEGL or libOSMesa)")
        png, lines = path.read_bytes(), path.with_suffix(".svg")
        found = {"lines": lines.read_text()} if lines.is_file() else {}
    keys = ("bounder", "section", "missed", "identical", "certificate", "fp_rate", "asked", "faster")
    runs = [{key: run.get(key) for key in keys} for run in reported["runs"]]
    png = d.with_palette(png, width) if width else png
    return found | {"runs": runs, "steps": reported.get("steps"), "picture": base64.b64encode(png).decode()}


def digits_parts(work, labels):
    return {"digits": partial(run_demo, "digits", "digits.png", work.choose(False, True))}


def digits(parts):
    png, lines = base64.b64decode(parts["digits"]["picture"]), parts["digits"].get("lines")
    return {"png": d.with_palette(png, 1250)} | ({"svg": lines.encode()} if lines else {})


def applications_parts(work, labels):
    return {name: partial(run_demo, name, own[0], True, 1000) for name, own in DEMOS.items()}


def applications(parts):
    panels = []
    for name, (_, share, title) in DEMOS.items():
        image = d.picture(base64.b64decode(parts[name]["picture"]))
        panels.append(Panel(image[: round(share * len(image))], title, framed=False))
    return d.grid([panels[:2], panels[2:]], svg=False, inch=6.0)


class Figure(NamedTuple):
    """What is computed and how it is drawn; which objects it shows, and how many of them in the quick form."""

    parts: object
    draw: object
    objects: tuple[str, ...] = ()
    few: int | None = None
    means: bool = False  # the page has means over the objects, not every rate


IN_2D = [f"2d/{name}" for name in "bunny chair dragon1 dragon2 house lucy star1 star2 teapot".split()]
IN_3D = [f"3d/{name}" for name in "airplane armchair bunny camera car dragon sofa teapot teddy".split()]
IN_4D = [f"4d/{name}" for name in "bunny dragon teapot".split()]
ROWS_3D = tuple(f"3d/{name}" for name in "bunny airplane armchair dragon teapot".split())
ROWS_2D = tuple(f"2d/{name}" for name in "bunny star1 dragon1 house teapot".split())
BY_SIZE = ("2d/bunny", "2d/star1", "3d/bunny", "3d/airplane", "4d/bunny", "4d/dragon")
FIGURES = {
    "teaser": Figure(teaser_parts, teaser, ("2d/dragon2", "3d/bunny", "4d/bunny")),
    "progressive": Figure(progressive_parts, progressive, ("2d/star1",)),
    "gallery": Figure(gallery_parts, gallery, ROWS_3D, 3, means=True),
    "objects": Figure(objects_parts, objects, (*IN_2D, *IN_3D, *IN_4D)),
    "kdop": Figure(kdop_parts, kdop, ROWS_2D, 3, means=True),
    "relu-fields": Figure(relu_fields_parts, relu_fields, ("2d/dragon1",)),
    "convergence": Figure(convergence_parts, convergence, ("2d/dragon1", "3d/bunny")),
    "complexity": Figure(complexity_parts, complexity, BY_SIZE, means=True),
    "hierarchy": Figure(hierarchy_parts, hierarchy),
    "inside-and-outside": Figure(sides_parts, sides, ("2d/star1", "2d/dragon2", "3d/bunny", "3d/teapot")),
    "digits": Figure(digits_parts, digits),
    "applications": Figure(applications_parts, applications),
}
