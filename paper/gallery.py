"""The paper's figures, by the protocol of ``figures.Figure``: what each computes and how it is drawn.

How to add one: a class here, a line in ``FIGURES`` at the end, a section in ``pages/figures.md``; all else follows.
"""

import base64
import tempfile
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from paper import drawing as d
from paper.data import fish
from paper.drawing import TINTS, Panel, layer, numbered, packed, raster, scene, unpack
from paper.figures import Figure, Work
from paper.results import heed
from warp_bounding.activations import DEFAULT
from warp_bounding.errors import BoundingError
from warp_bounding.shapes import Grid
from warp_bounding.shapes.parts import SIDES


def labels_of(parts) -> list[str]:
    """Names of the parts that are objects; others are measured."""
    return [name for name, part in parts.items() if "inside" in part]


def mean_of(parts, method: str) -> float:
    """False positives, over the parts whose name ends with a method."""
    return float(np.mean([part["fp"] for name, part in parts.items() if name.partition(" ")[2] == method]))


def flat(thing: dict[str, Any], part: dict[str, Any], tint: str, title: str = "") -> Panel:
    """A panel of an object in 2D with what a bounder adds to it and denies of it, and its rates."""
    return Panel(d.bounded(unpack(thing["inside"]), unpack(part["maybe"]), tint), title, numbered(part))


def solid(thing: dict[str, Any], part: dict[str, Any] | None, tint: str, *, glass: bool, near: bool) -> dict[str, Any]:
    """A scene of an object in 3D: with a bound around it, and in red what that denies; ``near``: it fills the view."""
    inside, layers = thing["inside"], []
    if part is not None:
        denied = d.pack(unpack(inside) & ~unpack(part["maybe"]))
        layers = [layer(denied, d.DENIED), layer(part["maybe"], tint, 0.45 if glass else 1.0, smooth=True)]
    body = [layer(inside, d.SOLID if part is not None else tint)] if glass or part is None else []
    return scene(*body, *layers, up=thing["up"], around=inside if near else None)


class Teaser(Figure):
    """Classic volumes and networks around one 2D object, and growing networks in two, three and four dimensions."""

    name = "teaser"
    objects = {"2d/dragon2": "2d/fish", "3d/bunny": "3d/bunny", "4d/bunny": "4d/bunny"}
    pixels, frame = {2: 256, 3: 72, 4: 72}, 2  # a raster's side; the step of time that is shown
    classic, hidden = ("aabb", "ellipsoid", "kdop", "occupancy", "mlp"), (20, 10, 5)
    growing = {
        2: ("4", "10", "20-10-5", "50-50"),
        3: ("4", "10-10", "25-25", "50-50"),
        4: ("4", "10-10", "25-25", "75-75"),
    }
    seconds = {2: (15, 2), 3: (40, 4), 4: (90, 8)}

    def parts(self, work: Work):
        parts = {}
        for ndim, label in zip(self.pixels, self.objects, strict=True):
            grid = work.shape(label)
            points = raster(grid, self.pixels[ndim], d.moment(grid, self.frame) if ndim == 4 else None)
            measured = partial(work.measured, grid, work.choose(*self.seconds[ndim]), points)
            parts[f"{ndim}d object"] = partial(work.shown, label, points)
            for method in self.classic if ndim == 2 else ():
                own = {"hidden": self.hidden} if method in ("occupancy", "mlp") else {}
                parts[f"2d {method}"] = partial(measured, method=method, **own)
            for widths in self.growing[ndim]:
                parts[f"{ndim}d {widths}"] = partial(measured, method="mlp", hidden=tuple(map(int, widths.split("-"))))
        return parts

    def draw(self, parts):
        thing, scenes = parts["2d object"], {}
        rows = [[flat(thing, parts[f"2d {method}"], TINTS[method], method) for method in self.classic]]
        for ndim in (3, 4):
            for name in ("object", *self.growing[ndim]):
                part = parts[f"{ndim}d {name}"] if name != "object" else None
                tint = d.SOLID if part is None else TINTS["mlp"]
                scenes[f"{ndim}d {name}"] = solid(parts[f"{ndim}d object"], part, tint, glass=True, near=False)
        pictures = d.images(scenes)
        for ndim, sizes in self.growing.items():
            first = pictures[f"{ndim}d object"] if ndim > 2 else d.tinted({d.OBJECT: unpack(thing["inside"])})
            row = [Panel(first, "object", side=f"{ndim}D")]
            for widths in sizes:
                part, title = parts[f"{ndim}d {widths}"], f"{ndim}-{widths}-1"
                image = pictures.get(f"{ndim}d {widths}")
                own = flat(thing, part, TINTS["mlp"], title) if ndim == 2 else Panel(image, title, numbered(part))
                row.append(own)
            rows.append(row)
        return d.grid(rows, svg=False)

    def facts(self, parts):
        reported = "; ".join(f"{name} {part['fp']:.2f} %" for name, part in parts.items() if "fp" in part)
        missed = parts["2d occupancy"]
        lines = [f"False positives of all points: {reported}."]
        return [
            *lines,
            f"False negatives of `occupancy`: {missed['fn']:,} of {missed['samples']:,}; of all others none.",
        ]


class Progressive(Figure):
    """One object, bounded by wider and wider networks."""

    name = "progressive"
    objects = {"2d/star1": "2d/star"}
    sizes = {"5-5": 10, "10-10": 15, "10-10-5": 20, "25-25-5": 30, "50-50": 40, "128-128-128 encoded": 120}  # seconds
    quick = {"5-5": 2, "10-10-5": 3, "25-25-5": 4, "50-50": 5}

    def parts(self, work: Work):
        (label,) = self.objects
        grid, points = work.shape(label), raster(work.shape(label), 256)
        parts = {"object": partial(work.shown, label, points)}
        for name, seconds in work.choose(self.sizes, self.quick).items():
            own = {"hidden": tuple(map(int, name.split()[0].split("-"))), "octaves": 4 if "encoded" in name else 0}
            parts[name] = partial(work.measured, grid, seconds, points, method="mlp", **own)
        return parts

    def draw(self, parts):
        sizes = {name: part for name, part in parts.items() if "fp" in part}

        def plot(axes) -> None:
            axes.plot(
                [p["numbers"] for p in sizes.values()], [p["fp"] for p in sizes.values()], "o-", color=TINTS["mlp"]
            )
            axes.set(xscale="log", ylim=(0, None), xlabel="parameters", title="false positives, %", box_aspect=1)
            axes.spines[["top", "right"]].set_visible(False)

        return d.grid([[*(flat(parts["object"], part, TINTS["mlp"], name) for name, part in sizes.items()), plot]])

    def facts(self, parts):
        sizes = {name: part for name, part in parts.items() if "fp" in part}
        reported = "; ".join(f"{name} ({p['numbers']:,} parameters) {p['fp']:.2f} %" for name, p in sizes.items())
        return [f"False positives: {reported}. False negatives: {sum(p['fn'] for p in sizes.values())}."]


class Gallery(Figure):
    """3D shapes by methods, with what is cut off in red."""

    name = "gallery"
    objects = {
        "3d/bunny": "3d/bunny",
        "3d/airplane": "3d/cup",
        "3d/armchair": None,
        "3d/dragon": None,
        "3d/teapot": None,
    }
    few = 3
    seconds = {"aabb": (60, 60), "kdop": (60, 60), "learned-kdop": (10, 4), "occupancy": (15, 6), "mlp": (60, 10)}

    def parts(self, work: Work):
        fits, parts = {m: (work.choose(*seconds), {"method": m}) for m, seconds in self.seconds.items()}, {}
        for label in self.wanted(work.settings):
            parts |= work.raster_parts(label, 80, fits, work.shape(label).name.partition(".")[0])
        return parts

    def draw(self, parts):
        names = {row: [row, *(f"{row} {method}" for method in self.seconds)] for row in labels_of(parts)}
        scenes = {}
        for row, own in names.items():
            for name, method in zip(own, ("", *self.seconds), strict=True):
                part, tint = (parts[name], TINTS[method]) if method else (None, d.SOLID)
                scenes[name] = solid(parts[row], part, tint, glass=False, near=True)
        pictures, titles = d.images(scenes), ("object", *self.seconds)
        rows = []
        for own in names.values():
            below = ["", *(numbered(parts[name]) for name in own[1:])]
            shown = zip(own, titles, below, strict=True)
            rows.append([Panel(pictures[name], title if not rows else "", text, False) for name, title, text in shown])
        return d.grid(rows, svg=False)

    def facts(self, parts):
        missed = sum(part.get("fn", 0) for part in parts.values())
        reported = "; ".join(f"`{method}` {mean_of(parts, method):.2f} %" for method in self.seconds)
        return [f"Mean false positives: {reported}; false negatives, all of `occupancy`: {missed:,}."]


class Objects(Figure):
    """The sheet of everything that the paper bounds."""

    name = "objects"
    objects = dict.fromkeys(
        [
            "2d/bunny",
            "2d/chair",
            "2d/dragon1",
            "2d/dragon2",
            "2d/house",
            "2d/lucy",
            "2d/star1",
            "2d/star2",
            "2d/teapot",
            "3d/airplane",
            "3d/armchair",
            "3d/bunny",
            "3d/camera",
            "3d/car",
            "3d/dragon",
            "3d/sofa",
            "3d/teapot",
            "3d/teddy",
            "4d/bunny",
            "4d/dragon",
            "4d/teapot",
        ]
    )
    pixels, frames, tints = {"2": 128, "3": 64, "4": 64}, (0, 3, 6), {"2": d.OBJECT, "3": "#8fa7bf", "4": "#c9a27c"}

    def parts(self, work: Work):
        def cells(label: str, time: float | None) -> dict[str, Any]:
            grid = work.shape(label)
            share = round(100 * float(grid.occupancy.mean()), 2)
            return work.shown(label, raster(grid, self.pixels[label[0]], time)) | {"occupied": share}

        parts = {}
        for label in self.wanted(work.settings):
            for frame in self.frames if label[0] == "4" else (None,):
                name = label if frame is None else f"{label}, step {frame + 1}"
                parts[name] = partial(cells, label, None if frame is None else d.moment(work.shape(label), frame))
        return parts

    def draw(self, parts):
        near = {name: name[0] == "3" for name in parts if name[0] != "2"}  # an animated one keeps its size
        scenes = {n: solid(parts[n], None, self.tints[n[0]], glass=False, near=own) for n, own in near.items()}
        pictures = d.images(scenes)
        pictures |= {n: d.tinted({d.OBJECT: unpack(p["inside"])}) for n, p in parts.items() if n not in pictures}
        rows = [[Panel(pictures[n], n[3:]) for n in parts if n[0] == ndim] for ndim in self.pixels]
        return d.grid(rows, svg=False, inch=1.15)

    def facts(self, parts):
        found = {name.partition(",")[0]: part["occupied"] for name, part in parts.items()}
        return ["Occupied cells, %: " + ", ".join(f"{name} {share:g}" for name, share in found.items()) + "."]


class Kdop(Figure):
    """Six half-spaces, with fixed normals and with learned ones, like for like."""

    name = "kdop"
    objects = {
        "2d/bunny": "2d/fish",
        "2d/star1": "2d/star",
        "2d/dragon1": "2d/crescent",
        "2d/house": None,
        "2d/teapot": None,
    }
    few, k = 3, 6
    rows = {"kdop": "fixed normals (kdop)", "learned-kdop": "learned normals (learned-kdop)"}

    def parts(self, work: Work):
        fits, parts = {m: (work.choose(10, 3), {"method": m, "k": self.k}) for m in self.rows}, {}
        for label in self.wanted(work.settings):
            parts |= work.raster_parts(label, 256, fits)
        return parts

    def draw(self, parts):
        rows = []
        for method, side in self.rows.items():
            row = [flat(parts[label], parts[f"{label} {method}"], TINTS[method]) for label in labels_of(parts)]
            rows.append([row[0]._replace(side=side), *row[1:]])
        return d.grid(rows)

    def facts(self, parts):
        fixed, learned = (mean_of(parts, method) for method in self.rows)
        reported = f"`kdop` {fixed:.2f} %, `learned-kdop` {learned:.2f} %: {learned / fixed:.2f} times"
        return [f"Mean false positives with k = {self.k}: {reported}."]


class ReluFields(Figure):
    """Pixels, a field that is trained as a classifier, and ours, all of the same resolution."""

    name = "relu-fields"
    objects = {"2d/dragon1": "2d/fish"}
    pixels, nodes = 384, 12  # of a raster's side, a multiple of the next; of all three along each axis
    titles = {"pixels": "pixels", "plain": "field, as a classifier", "ours": "field, ours (proven)"}

    def parts(self, work: Work):
        (label,) = self.objects
        grid, nodes, s = work.shape(label), self.nodes, work.settings
        points = raster(grid, self.pixels)

        def measured(ask) -> dict[str, Any]:
            """Rates of an answer to points, as ``Work.rates`` has them."""
            rng = np.random.default_rng(s["seed"] + 1)
            x = rng.uniform(grid.sample_lower, grid.sample_upper, (s["samples"], grid.ndim)).astype(np.float32)
            truth, maybe = grid.contains(x.astype(np.float64)), ask(x.astype(np.float64))
            counts = {"fp": round(100 * float((maybe & ~truth).mean()), 4), "fn": int((~maybe & truth).sum())}
            shown = ask(points.reshape(-1, 2).astype(np.float64)).reshape(points.shape[:-1])
            return {**counts, "samples": len(x), "maybe": d.pack(shown)}

        def pixels() -> dict[str, Any]:
            block = self.pixels // nodes
            marked = unpack(packed(grid, points)).reshape(nodes, block, nodes, block).any(axis=(1, 3))
            at = lambda x: np.floor((x - grid.lower) / (grid.upper - grid.lower) * nodes).astype(int)  # noqa: E731
            return measured(lambda x: marked[tuple(at(x).clip(0, nodes - 1).T)])

        def plain() -> dict[str, Any]:
            from paper.comparisons import plain_field

            return measured(plain_field(grid, nodes, s["seed"], 1500, 8192, 0.05))  # steps, batch, rate

        ours = partial(work.measured, grid, work.choose(20, 4), points, method="relu-field", nodes=nodes)
        return {"object": partial(work.shown, label, points), "pixels": pixels, "plain": plain, "ours": ours}

    def draw(self, parts):
        tints = zip(self.titles, ("voxels", "occupancy", "relu-field"), strict=True)
        return d.grid([[flat(parts["object"], parts[n], TINTS[tint], self.titles[n]) for n, tint in tints]])

    def facts(self, parts):
        reported = (f"{title}: {numbered(parts[n])}, {parts[n]['seconds']:.0f} s" for n, title in self.titles.items())
        return [f"{'; '.join(reported)}."]


class Convergence(Figure):
    """Both errors over training, with the asymmetric loss and with the common one."""

    name = "convergence"
    objects = {"2d/dragon1": "2d/fish", "3d/bunny": "3d/bunny"}
    hidden, steps = {2: (25, 25), 3: (50, 50)}, {2: (8_000, 1_600), 3: (6_400, 1_200)}  # steps: full, quick
    losses = {"asymmetric": ("ours: asymmetric", "#1f6fb4"), "common": ("common: symmetric", "#d62b2b")}
    least = 0.003  # per cent; below, the axis is linear

    def parts(self, work: Work):
        def trained(grid, loss: str) -> dict[str, Any]:
            from paper.comparisons import record

            steps = max(8, round(work.choose(*self.steps[grid.ndim]) * work.settings["effort"]))
            sizes = {
                "steps": steps,
                "stage": steps // 8,
                "every": max(1, steps // 64),
                "batch": work.choose(4096, 2048),
            }
            own = {"common": loss == "common", "seed": work.settings["seed"], "note": lambda text: heed()}
            return {**record(grid, self.hidden[grid.ndim], DEFAULT.name, **sizes, **own), "stage": sizes["stage"]}

        wanted = self.wanted(work.settings)
        return {
            f"{label} {loss}": partial(trained, work.shape(label), loss) for label in wanted for loss in self.losses
        }

    def draw(self, parts):
        def plot(label: str, axes) -> None:
            for loss, (reported, colour) in self.losses.items():
                part = parts[f"{label} {loss}"]
                axes.plot(part["step"], part["fn"], color=colour, label=f"{reported}, false negatives")
                axes.plot(part["step"], part["fp"], ":", color=colour, label=f"{reported}, false positives")
            for step in range(part["stage"], part["step"][-1], part["stage"]):
                axes.axvline(step, color=d.PALE, linewidth=0.8, zorder=0)
            axes.set_yscale("symlog", linthresh=self.least, linscale=0.4)
            axes.set_yticks([0, 0.01, 0.1, 1, 10, 100], ["0", "0.01", "0.1", "1", "10", "100"])
            axes.set(
                ylim=(-self.least / 4, 100), xlim=(0, part["step"][-1]), xlabel="training steps", ylabel="% of points"
            )
            axes.minorticks_off()
            axes.set_title(f"{label[0]}D {label[3:]}", loc="left", fontsize=10, fontweight="bold")
            axes.spines[["top", "right"]].set_visible(False)

        labels = list(dict.fromkeys(name.partition(" ")[0] for name in parts))
        return d.grid([[partial(plot, label) for label in labels]], inch=4.0, legend=True)

    def facts(self, parts):
        reported = [f"{name}: FP {part['fp'][-1]:.2f}, FN {part['fn'][-1]:.3f}" for name, part in parts.items()]
        return [f"At the last record, %: {'; '.join(reported)}."]


class Complexity(Figure):
    """False positives against the size of the network, by dimension."""

    name = "complexity"
    objects = {"2d/bunny": "2d/fish", "2d/star1": "2d/star", "3d/bunny": "3d/bunny", "3d/airplane": "3d/cup"}
    objects |= {"4d/bunny": "4d/bunny", "4d/dragon": "4d/cup"}
    widths = {2: (10, 16, 25, 50, 75, 125), 3: (16, 25, 50, 75, 125), 4: (25, 50, 75)}  # of both hidden layers
    quick, baselines = {2: (10, 25), 3: (16, 32), 4: (16, 32)}, {"obb": "-", "sphere": "--"}
    seconds, wide = {2: (10, 2), 3: (30, 5), 4: (60, 8)}, 50  # neurons from which the seconds grow with the width

    def wanted(self, settings):
        found = super().wanted(settings)
        return [next(label for label in found if label[0] == n) for n in "234"] if settings["quick"] else found

    def parts(self, work: Work):
        parts = {}
        for label in self.wanted(work.settings):
            grid, ndim = work.shape(label), int(label[0])
            for method in self.baselines:
                parts[f"{label} {method}"] = partial(work.measured, grid, 60.0, method=method)
            for width in work.choose(self.widths, self.quick)[ndim]:
                seconds = work.choose(*self.seconds[ndim]) * max(1.0, width / self.wide)
                own = {"method": "mlp", "hidden": (width, width)}
                parts[f"{label} mlp {width}"] = partial(work.measured, grid, seconds, **own)
        return parts

    @staticmethod
    def _rates(parts, ndim: int) -> dict[str, list[dict[str, Any]]]:
        """Parts of a dimension, of all objects, by method, or ``mlp`` and width."""
        found: dict[str, list] = {}
        for name, part in parts.items():
            if name[0] == str(ndim):
                found.setdefault(name.partition(" ")[2], []).append(part)
        return found

    def draw(self, parts):
        def plot(ndim: int, axes) -> None:
            found = self._rates(parts, ndim)
            networks = sorted((own[0]["numbers"], [p["fp"] for p in own]) for n, own in found.items() if n[:3] == "mlp")
            size, rates = [n for n, _ in networks], np.array([own for _, own in networks])
            axes.fill_between(size, rates.min(axis=1), rates.max(axis=1), color=TINTS["mlp"], alpha=0.25, linewidth=0)
            axes.plot(size, rates.mean(axis=1), "o-", color=TINTS["mlp"], label="mlp")
            for method, style in self.baselines.items():
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
            axes.set_ylabel("false positives, % (log scale)" if ndim == 2 else "")

        return d.grid([[partial(plot, ndim) for ndim in self.widths]], inch=3.0, legend=True)

    def facts(self, parts):
        lines = []
        for ndim in self.widths:
            means = {name: np.mean([p["fp"] for p in own]) for name, own in self._rates(parts, ndim).items()}
            lines.append(f"{ndim}D: " + ", ".join(f"`{name}` {rate:.2f}" for name, rate in means.items()))
        return [f"Mean false positives, %: {'; '.join(lines)}."]


class Hierarchy(Figure):
    """A school of fish: one network, networks of its parts, and both together."""

    name = "hierarchy"
    tints = {"root": "#5b9bd5", "children": "#f2c230", "leaves": "#e77fb3"}  # as in the paper
    titles = {
        "root": "one network",
        "children": "two children",
        "leaves": "four leaves",
        "together": "one and four together",
    }
    hidden, steps = (
        {"root": (16, 16), "children": (12, 12), "leaves": (10, 10)},
        (4000, 500),
    )  # steps of each: full, quick
    school = (  # centres, lengths and angles of the fish, of which the upper ones swim a little downwards
        (0.14, 0.83, 0.17, -0.25), (0.33, 0.9, 0.15, -0.15), (0.29, 0.74, 0.19, -0.3), (0.49, 0.79, 0.16, -0.1),
        (0.46, 0.93, 0.12, -0.2), (0.66, 0.87, 0.15, -0.05), (0.83, 0.78, 0.17, 0.1), (0.65, 0.7, 0.13, 0.0),
        (0.2, 0.21, 0.18, 0.2), (0.4, 0.3, 0.15, 0.1), (0.39, 0.13, 0.16, 0.15), (0.59, 0.2, 0.19, 0.05),
        (0.78, 0.32, 0.15, -0.1), (0.8, 0.13, 0.14, 0.1), (0.6, 0.38, 0.11, 0.0), (0.91, 0.22, 0.11, 0.0),
    )  # fmt: skip

    def parts(self, work: Work):
        def levels() -> dict[str, Any]:
            from warp_bounding.bounders import cascade
            from warp_bounding.training import fit, hierarchy

            at = np.stack(np.meshgrid(*[np.linspace(0, 1, 160)] * 2, indexing="ij"), axis=-1)
            cells = np.any([fish(at, (x, y), 1.25 * size, angle) for x, y, size, angle in self.school], axis=0)
            grid, steps = (
                Grid(cells, name="school"),
                max(1, round(work.choose(*self.steps) * work.settings["effort"])),
            )
            own, bounders = {"method": "mlp", "steps": steps, "seed": work.settings["seed"], "device": "cpu"}, {}
            for depth, (level, hidden) in enumerate(self.hidden.items()):
                make = partial(hierarchy, levels=depth) if depth else fit
                bounders[level] = make(grid, hidden=hidden, **own)
                heed()
            bounders["together"] = cascade(bounders["root"], bounders["leaves"])
            points = raster(grid, 400)
            found = {name: {**work.rates(b, grid), "maybe": packed(b, points)} for name, b in bounders.items()}
            return {"inside": packed(grid, points), "levels": found}

        return {"school": levels}

    def draw(self, parts):
        row, levels = [], parts["school"]["levels"]
        for name, title in self.titles.items():
            shown = [name] if name in self.tints else ["root", "leaves"]
            layers = {self.tints[each]: unpack(levels[each]["maybe"]) for each in shown}
            image = d.tinted(layers | {d.OBJECT: unpack(parts["school"]["inside"])})
            row.append(Panel(image, title, numbered(levels[name])))
        return d.grid([row], inch=2.5)

    def facts(self, parts):
        levels = parts["school"]["levels"].items()
        reported = (
            f"{self.titles[n]} {p['fp']:.2f} % ({p['nbytes'] / 1000:.1f} kB, {p['certificate']})" for n, p in levels
        )
        return [f"False positives: {'; '.join(reported)}."]

    def broken(self, parts):
        return super().broken(parts["school"]["levels"])


class Sides(Figure):
    """Where a point is certainly not in the object, and where it certainly is."""

    name = "inside-and-outside"
    objects = {"2d/star1": "2d/star", "2d/dragon2": "2d/fish", "3d/bunny": "3d/bunny", "3d/teapot": "3d/cup"}
    never, always, within = "#a9cbe8", "#f2bd1d", "#6d8296"
    pixels, hidden, seconds = {2: 256, 3: 80}, {2: (25, 25), 3: (50, 50)}, {2: (30, 6), 3: (90, 12)}

    def parts(self, work: Work):
        parts = {}
        for label in self.wanted(work.settings):
            n, stem = int(label[0]), work.shape(label).name.partition(".")[0]
            own, seconds = {"method": "mlp", "hidden": self.hidden[n]}, work.choose(*self.seconds[n])
            fits = {side: (seconds, own | {"side": side}) for side in SIDES}
            parts |= work.raster_parts(label, self.pixels[n], fits, f"{n}D-{stem}")
        return parts

    def draw(self, parts):
        masks, scenes, row = {}, {}, []
        for name in labels_of(parts):
            never, always = (~unpack(parts[f"{name} {side}"]["maybe"]) for side in SIDES)
            masks[name], body = (never, always), layer(d.pack(always), self.always, smooth=True)
            glass = layer(parts[name]["inside"], d.SOLID, 0.35, smooth=True)
            if name[0] == "3":
                scenes[name] = scene(body, glass, up=parts[name]["up"], around=parts[name]["inside"])
        pictures = d.images(scenes)
        for name, (never, always) in masks.items():
            inside, image = unpack(parts[name]["inside"]), pictures.get(name)
            image = d.tinted({self.within: inside, self.never: never, self.always: always}) if image is None else image
            share = np.floor(1000 * (never | always).mean()) / 10  # what is not certain everywhere is not told to be
            row.append(Panel(image, name[3:], f"certain: {share:.1f} % of all", name not in pictures))
        return d.grid([row], svg=False, inch=2.4)

    def facts(self, parts):
        lines = []
        for name in labels_of(parts):
            outer, inner = (parts[f"{name} {side}"] for side in SIDES)
            reported = (
                f"maybe {outer['fp']:.2f} % outside and {inner['fp']:.2f} % inside, of {outer['samples']:,} points"
            )
            lines.append(
                f"{name[3:]} ({name[:2]}): {reported} of which {100 - inner['positives']:.1f} % are in the object"
            )
        return [f"{'; '.join(lines)}."]


class Distances(Figure):
    """How far below the true distance a proven one is, and how far outside the true offsets its level lines."""

    name = "distances"
    objects = {"2d/star1": "2d/star", "2d/bunny": "2d/fish"}
    radii, tints = (0.02, 0.05, 0.1, 0.2), ("#0b3c8c", "#1f7fd0", "#39b8d9", "#8fd3c8")  # of level lines
    around, most = 0.28, 0.2  # of what is shown around an object's domain; the largest gap that colours tell apart

    def parts(self, work: Work):
        parts = {}
        for label in self.wanted(work.settings):
            grid = work.shape(label)
            middle, longest = (grid.lower + grid.upper) / 2, (grid.upper - grid.lower).max()
            points = middle + (raster(grid, 160).astype(np.float64) - middle) * (1 + 2 * self.around / longest)
            parts[label] = partial(self._truth, grid, points.astype(np.float32))
            parts[f"{label} mlp"] = partial(self._bounded, work, grid, points.astype(np.float32))
        return parts

    @staticmethod
    def _truth(grid, points: np.ndarray) -> dict[str, Any]:
        return {"inside": packed(grid, points), "distance": d.pack_numbers(d.distances(grid, points))}

    def _bounded(self, work: Work, grid, points: np.ndarray) -> dict[str, Any]:
        """What the network is, how tight at each radius, and the gap at the points of a raster."""
        from warp_bounding.evaluation import evaluate

        bounder = work.fit(grid, work.choose(40, 6), "distance", method="mlp", hidden=(16, 16))
        reported, rates, s = work.rates(bounder, grid), [], work.settings
        for radius in self.radii:
            found = evaluate(bounder, grid, s["samples"], seed=s["seed"] + 1, radius=radius)
            rates.append(round(float(found.fp_rate), 4))
            reported["fn"] += int(found.fn)
        truth = d.distances(grid, points)
        gap = truth - bounder.distance(points.reshape(-1, 2)).numpy().reshape(truth.shape).astype(np.float64)
        outside, corner, side = gap[truth > 0], points[0, 0], points[-1, -1] - points[0, 0]
        reported["box"] = [((end - corner) / side).tolist() for end in (bounder.domain.lower, bounder.domain.upper)]
        reported |= {"slack": bounder.slack, "mean": outside.mean(), "least": outside.min(), "most": outside.max()}
        return reported | {"rates": rates, "gap": d.pack_numbers(gap)}

    def draw(self, parts):
        from matplotlib.colors import PowerNorm
        from matplotlib.patches import Rectangle

        extent, labels = (0.0, 1.0, 0.0, 1.0), labels_of(parts)
        lines = {"extent": extent, "origin": "upper", "levels": self.radii, "colors": self.tints}

        def plot(label: str, axes) -> None:
            truth, own = parts[label], parts[f"{label} mlp"]
            distance, gap = d.unpack_numbers(truth["distance"]), d.unpack_numbers(own["gap"])
            image = axes.imshow(d.upright(gap), cmap="YlOrRd", norm=PowerNorm(0.5, 0, self.most), extent=extent)
            axes.contour(d.upright(distance - gap), linewidths=2, **lines)
            axes.contour(d.upright(distance), linewidths=0.8, **lines)
            body = {"extent": extent, "origin": "upper", "levels": [0.5, 1.5], "colors": [d.OBJECT]}
            axes.contourf(d.upright(unpack(truth["inside"])), **body)
            low, high = np.array(own["box"])
            axes.add_patch(Rectangle(low, *(high - low), fill=False, ls="--", lw=0.8, ec=d.INK))
            axes.set(xticks=[], yticks=[], title=label)
            axes.set_xlabel(f"{own['nbytes']:,} bytes, slack {own['slack']:.2g}, mean gap {own['mean']:.4f}")
            if label == labels[-1]:
                axes.figure.colorbar(image, ax=axes, extend="max", shrink=0.8, label="true distance - bound")

        return d.grid([[partial(plot, label) for label in labels]], inch=4.2)

    def facts(self, parts):
        reported = []
        for label in labels_of(parts):
            own = parts[f"{label} mlp"]
            rates = ", ".join(
                f"{rate:.2f} % at {radius}" for radius, rate in zip(self.radii, own["rates"], strict=True)
            )
            reported.append(
                f"{label}: {own['nbytes']:,} bytes, {own['certificate']}, slack {own['slack']:.2g}; the gap of points "
                "outside "
                f"is {own['mean']:.4f} on average, {own['least']:.4f} to {own['most']:.4f}; false positives "
                f"{own['fp']:.2f} % "
                f"at radius 0, {rates}; false negatives {own['fn']}."
            )
        return reported


PROVEN, UNPROVEN = "mlp", "occupancy"


def run_demo(work: Work, name: str, file: str, quick: bool, width: int | None = None) -> dict[str, Any]:
    """A part: what a demo of ``sims`` told of its runs, and its picture; its text goes to standard error."""
    from sims.report import output

    with tempfile.TemporaryDirectory() as folder:
        demo = import_module(f"sims.{name}")
        reported = demo.run(Path(folder), quick=quick, seed=0, device="cpu", console=output(stderr=True))
        heed()
        path = Path(folder) / file
        if not path.is_file():
            raise BoundingError(f"the demo {name} drew nothing: off-screen drawing needs OpenGL (libEGL or libOSMesa)")
        png, lines = path.read_bytes(), path.with_suffix(".svg")
        found = {"lines": lines.read_text()} if lines.is_file() else {}
    keys = ("bounder", "section", "missed", "identical", "certificate", "fp_rate", "asked", "faster")
    runs = [{key: run.get(key) for key in keys} for run in reported["runs"]]
    png = d.with_palette(png, width) if width else png
    return found | {"runs": runs, "steps": reported.get("steps"), "picture": base64.b64encode(png).decode()}


def broken_runs(parts, promised) -> list[str]:
    """Runs of demos that missed something, or ended otherwise, and were promised not to."""
    runs = [(name, run) for name, part in parts.items() for run in part["runs"] if promised(run)]
    return [
        f"{name}, {run['section']}: {run['missed']} missed"
        for name, run in runs
        if run["missed"] or not run["identical"]
    ]


class Digits(Figure):
    """A generative model, bounded before it is run."""

    name = "digits"

    def parts(self, work: Work):
        return {"digits": partial(run_demo, work, "digits", "digits.png", work.choose(False, True))}

    def draw(self, parts):
        png, lines = base64.b64decode(parts["digits"]["picture"]), parts["digits"].get("lines")
        return {"png": d.with_palette(png, 1250)} | ({"svg": lines.encode()} if lines else {})

    def facts(self, parts):
        lines = []
        for run in parts["digits"]["runs"]:
            if run["bounder"] == PROVEN:
                lines.append(
                    f"{run['section']}: {run['certificate']}, {run['fp_rate']:.1f} % false positives of the box of "
                    "latent "
                    f"numbers and pixels, the decoder is run for {run['asked']:.0f} % of the pixels, "
                    f"{run['faster']:.1f} times "
                    f"as fast, {run['missed']:,} pixels of ink missed"
                )
            elif run["bounder"] == UNPROVEN:
                lines[-1] += f" (`occupancy`, the usual loss and no proof: {run['missed']:,})"
        return [f"{line}." for line in lines]

    def broken(self, parts):
        return broken_runs(parts, lambda run: run["certificate"] == "proven")


class Applications(Figure):
    """The four demos, with a proven network and with one that is not."""

    name = "applications"
    demos = {  # the picture that a demo draws, the share of its height that is shown, and what is said of it
        "path": ("path.png", 0.482, "2D paths"),
        "cloth": ("cloth.png", 1.0, "cloth on a mesh"),
        "particles": ("rain.png", 1.0, "particles on a moving mesh"),
        "shadows": ("shadows.png", 1.0, "shadow rays"),
    }

    def parts(self, work: Work):
        return {name: partial(run_demo, work, name, own[0], True, 1000) for name, own in self.demos.items()}

    def draw(self, parts):
        panels = []
        for name, (_, share, title) in self.demos.items():
            image = d.picture(base64.b64decode(parts[name]["picture"]))
            panels.append(Panel(image[: round(share * len(image))], title, framed=False))
        return d.grid([panels[:2], panels[2:]], svg=False, inch=6.0)

    def facts(self, parts):
        lines = []
        for name, part in parts.items():
            runs = [run for run in part["runs"] if run["bounder"] in (PROVEN, UNPROVEN)]
            reported = ", ".join(
                f"`{r['bounder']}` {r['section'] or ''} missed {r['missed']:,}".replace("  ", " ") for r in runs
            )
            lines.append(f"{name} (steps: {part['steps']}): {reported}")
        return [f"What was missed (contacts, colliding states and edges, shadow pixels): {'; '.join(lines)}."]

    def broken(self, parts):
        return broken_runs(parts, lambda run: run["bounder"] == PROVEN)


FIGURES: tuple[Figure, ...] = (
    *(Teaser(), Progressive(), Gallery(), Objects(), Kdop(), ReluFields(), Convergence(), Complexity()),
    *(Hierarchy(), Sides(), Distances(), Digits(), Applications()),
)
