"""When a cull of Newton's particle-shape pass pays: `python benchmarks/newton_map.py --out results/newton`.

Bunnies and stars stand in a square on a ground plane, turned, every third on a body, with particles between and above
them, spread evenly. A cell of the map is a number of particles, of meshes, and a contact gap. A round moves the
particles and bodies, then times `collide` of that very state without a cull, with one that has no bounders, so that of
meshes only the boxes are tested, and with bounders of distances that come with the demos, in turns of one pass each;
what the cull does is timed with it. Shares of the time without are taken within a turn, and the row keeps their
medians. Contacts are compared record by record in every cell.

Newton's kernels run on one core of a CPU. So does the cull, but for the row that says otherwise. Rows are kept as they
are known: run again, it goes on where it stopped.
"""

import argparse
import os
import statistics
import sys
import time
from contextlib import nullcontext
from pathlib import Path

import newton
import numpy as np
import warp as wp

import warp_bounding as wb
from sims.cloth.scene import RADIUS, SHAPES, newton_mesh
from sims.prefitted import stored
from sims.threads import threads_of
from warp_bounding.newton import Cull

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # Python has put this folder there, not the one above it

from shared import StoredRows

PARTICLES, MESHES, GAPS = (1_000, 10_000, 50_000, 100_000), (1, 4, 16, 64), (0.01, 0.05, 0.2)
SPACING, TOP = 2.4, 2.5  # from one mesh to the next; how high particles are; metres (a bunny is 1.6 high)
SHAKEN = 0.05  # how far particles and bodies move from round to round
WARM_UP = 2  # rounds that load kernels and find a pace
TESTED = 3e5  # pairs: a smaller pass has more turns in a round, until about as many are tested
MOST_TURNS = 25
WAYS = {"boxes": "without bounders", "distance": "with bounders", "cores": "with bounders, the cull on all cores"}
RECORDS = ("particle", "shape", "body_pos", "body_vel", "normal")


def scene(particles: int, meshes: int) -> tuple[newton.ModelBuilder, dict[int, str]]:
    """A builder, and the names of the meshes by the index of their shape."""
    rng, across = np.random.default_rng(0), int(np.ceil(np.sqrt(meshes)))
    builder, named = newton.ModelBuilder(up_axis=newton.Axis.Y), {}
    builder.add_ground_plane()
    for number in range(meshes):
        row, column = divmod(number, across)
        turn = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), float(rng.uniform(0, 2 * np.pi)))
        name = SHAPES[number % len(SHAPES)]
        place = wp.transform(wp.vec3(SPACING * column, 0.0 if name == "bunny" else 0.9, SPACING * row), turn)
        body = builder.add_body(xform=place, mass=1.0) if number % 3 == 2 else -1
        local = wp.transform_identity() if body >= 0 else place
        named[builder.add_shape_mesh(body=body, xform=local, mesh=newton_mesh(name))] = name
    half = SPACING / 2
    lower, upper = [-half, 0.0, -half], [SPACING * across - half, TOP, SPACING * across - half]
    x = rng.uniform(lower, upper, (particles, 3))
    builder.add_particles(x.tolist(), [[0.0] * 3] * particles, [0.01] * particles, [RADIUS] * particles)
    return builder, named


def records(contacts: newton.Contacts) -> list[np.ndarray]:
    """Contacts by particle and shape; on CUDA their own order is by chance."""
    count = int(contacts.soft_contact_count.numpy()[0])
    rows = [getattr(contacts, f"soft_contact_{name}").numpy()[:count] for name in RECORDS]
    order = np.lexsort((rows[1], rows[0]))
    return [row[order] for row in rows]


class Cell:
    """A cell of the map: the model, three culls, and the pass without."""

    def __init__(self, particles: int, meshes: int, gap: float, device: str):
        builder, named = scene(particles, meshes)
        self._model = builder.finalize(device=device)
        files = {name: wb.load(stored("cloth", f"{name}-distance"), device=device) for name in SHAPES}
        self._state, self._rng = self._model.state(), np.random.default_rng(1)
        pipeline = newton.CollisionPipeline(self._model, soft_contact_gap=gap)
        self._contacts = pipeline.contacts()
        self.boxes = Cull(pipeline)
        self.cull = Cull(pipeline, {shape: files[name] for shape, name in named.items()})
        self._ways = {"none": pipeline.collide, "boxes": self.boxes.collide, "distance": self.cull.collide}
        if self._model.device.is_cpu and (os.cpu_count() or 1) > 1:
            self._ways["cores"] = self.cull.collide
        self._turns = min(MOST_TURNS, max(1, int(TESTED / self.cull.pairs)))

    def shake(self) -> None:
        """Move particles and bodies a little."""
        for array in (self._state.particle_q, self._state.body_q):
            if array is not None:
                values = array.numpy()
                values[:, :3] += self._rng.normal(0, SHAKEN, (len(values), 3))
                array.assign(values)

    def compare(self) -> int:
        """The number of contacts; those with the culls must be the same, record by record."""
        self._ways["none"](self._state, self._contacts)
        there = records(self._contacts)
        for name in ("boxes", "distance"):
            self._ways[name](self._state, self._contacts)
            if not all(np.array_equal(a, b) for a, b in zip(there, records(self._contacts), strict=True)):
                raise wb.BounderError(f"expected the contacts of all pairs, got others with the cull {name}")
        return len(there[0])

    def round(self) -> list[dict[str, float]]:
        """Seconds of a pass, each way; a few times, in turns."""
        self.shake()
        return [{name: self._timed(name) for name in self._ways} for _ in range(self._turns)]

    def _timed(self, name: str) -> float:
        with nullcontext() if name == "cores" else threads_of(1):
            wp.synchronize_device(self._model.device)
            begin = time.perf_counter()
            self._ways[name](self._state, self._contacts)
            wp.synchronize_device(self._model.device)
            return time.perf_counter() - begin


def measure(particles: int, meshes: int, gap: float, rounds: int, device: str) -> dict:
    """A row of the map."""
    cell = Cell(particles, meshes, gap, device)
    contacts = cell.compare()
    for _ in range(WARM_UP):
        cell.round()
    times = [turn for _ in range(rounds) for turn in cell.round()]
    row = {"particles": particles, "meshes": meshes, "gap": gap, "pairs": cell.cull.pairs, "contacts": contacts}
    row |= {"left": {"boxes": cell.boxes.survivors, "distance": cell.cull.survivors}, "turns": len(times)}
    row["ms"] = {name: 1e3 * statistics.median(t[name] for t in times) for name in times[0]}
    row["share"] = {n: statistics.median(t[n] / t["none"] for t in times) for n in times[0] if n != "none"}
    return row


def drawn(kept: StoredRows, file: Path) -> None:
    """The map: how many times as fast, gaps side by side, ways one under another."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.colors import LogNorm

    gaps = sorted({row["gap"] for row in kept.rows})
    across, down = (sorted({row[key] for row in kept.rows}) for key in ("particles", "meshes"))
    ways = [way for way in WAYS if any(way in row["share"] for row in kept.rows)]
    size = (1.0 + 0.85 * len(across) * len(gaps), 1.2 + 0.62 * len(down) * len(ways))
    figure, axes = plt.subplots(len(ways), len(gaps), figsize=size, squeeze=False, layout="constrained")
    norm = LogNorm(1 / 8, 8)
    for way, line in zip(ways, axes, strict=True):
        for gap, axis in zip(gaps, line, strict=True):
            values = np.full((len(down), len(across)), np.nan)
            for row in kept.rows:
                if row["gap"] == gap and way in row["share"]:
                    values[down.index(row["meshes"]), across.index(row["particles"])] = 1.0 / row["share"][way]
            image = axis.imshow(values, cmap="RdBu", norm=norm, origin="lower", aspect="auto")
            for (y, x), value in np.ndenumerate(values):
                if np.isfinite(value):
                    dark = abs(np.log2(value)) > 1.7
                    axis.text(x, y, f"{value:.2g}", ha="center", va="center", color="white" if dark else "black")
            axis.set_xticks(range(len(across)), [f"{n // 1000}k" if n >= 1000 else str(n) for n in across])
            axis.set_yticks(range(len(down)), [str(n) for n in down])
            if way == ways[0]:
                axis.set_title(f"contact gap {gap:g} m")
            if way == ways[-1]:
                axis.set_xlabel("particles")
            if gap == gaps[0]:
                axis.set_ylabel(f"{WAYS[way].replace(', ', ',' + chr(10))}\nmeshes")
    bar = figure.colorbar(image, ax=axes, label="time without the cull / time with it", shrink=0.8)
    ticks = [1 / 8, 1 / 4, 1 / 2, 1, 2, 4, 8]
    bar.set_ticks(ticks, labels=[f"{t:g}" for t in ticks])
    bar.minorticks_off()
    figure.savefig(file, dpi=110)
    plt.close(figure)


SHOWN = 0.05  # metres of contact gap, of the table; the file has all
CONCLUSION = (
    "It pays with tens of thousands of particles, or with many meshes; most of it comes from boxes. With about a\n"
    "thousand particles, or where the contact gap is wide, it hardly does. Contacts are the same, record by record.",
    "Without a graph it pays with a million particles, and costs more than it saves with ten thousand, since launches\n"
    "take the time. [In a graph](../../gpu/README.md) it pays earlier. Contacts are the same, record by record.",
)  # on a CPU, on a GPU


def page(kept: StoredRows, command: str) -> str:
    """The page that holds the rows."""
    newtons = ", ".join(dict.fromkeys(row["newton"] for row in kept.rows))
    notes = "; ".join(dict.fromkeys(row["note"] for row in kept.rows if row["note"]))
    devices = ", ".join(dict.fromkeys(row["device"] for row in kept.rows))
    lines = ["# When a cull of Newton's particle-shape pass pays", ""]
    lines += [CONCLUSION["cuda" in devices], "", f"`{command}`", ""]
    lines += [f"{kept.about}; Newton {newtons}; on {devices}{'; ' + notes if notes else ''}.", ""]
    lines += [
        "Bunnies and stars stand in a square on a ground plane, every third on a body, with particles between and"
    ]
    lines += ["above them. Ways are timed in turns, and compared within a turn; medians.", ""]
    if _is_map(kept):
        lines += ["![How many times as fast, by particles, meshes and contact gap](map.png)", ""]
    ways = [way for way in WAYS if any(way in row["share"] for row in kept.rows)]
    lines += [
        f"Contact gap {SHOWN:g} m; [newton.jsonl](newton.jsonl) has the others. *Left*: the share of the pairs that",
        "Newton's pass still goes through. *Times as fast*: time without the cull / time with it.",
        "",
        "| particles | meshes | pairs | left | ms, none | " + "".join(f"times as fast, {WAYS[way]} |" for way in ways),
        "|" + "---:|" * (5 + len(ways)),
    ]
    for row in sorted(kept.rows, key=lambda r: (r["meshes"], r["particles"])):
        if row["gap"] != SHOWN:
            continue
        cells = [f"{row['particles']:,}", row["meshes"], f"{row['pairs']:,}"]
        cells += [f"{100 * row['left']['distance'] / row['pairs']:.2f} %", f"{row['ms']['none']:.2f}"]
        cells += [_bold(1 / row["share"][way]) if way in row["share"] else "–" for way in ways]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines) + "\n"


def _is_map(kept: StoredRows) -> bool:
    """Whether there is more than a line of cells to draw."""
    return len({(row["meshes"], row["gap"]) for row in kept.rows}) > 1


def _bold(times: float) -> str:
    return f"**{times:.2f}**" if times >= 1 else f"{times:.2f}"


def numbers(kind: type):
    """An option that is a list of positive numbers, with commas between."""

    def read(text: str) -> tuple:
        try:
            found = tuple(kind(part) for part in text.split(","))
        except ValueError:
            found = ()
        if not found or min(found) <= 0:
            raise argparse.ArgumentTypeError(f"expected positive numbers with commas between, got {text!r}")
        return found

    return read


def main() -> None:
    """Measure what is not there yet, and make the page and the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results/newton"))
    parser.add_argument("--particles", type=numbers(int), default=PARTICLES, help="with commas between")
    parser.add_argument("--meshes", type=numbers(int), default=MESHES, help="with commas between")
    parser.add_argument("--gaps", type=numbers(float), default=GAPS, help="metres, with commas between")
    parser.add_argument("--rounds", type=int, default=9, help="each with other places of particles and bodies")
    parser.add_argument("--device", default="cpu")
    parser.add_argument(
        "--note", default="", help="what else the reader should know of the machine; kept with the rows"
    )
    parser.add_argument("--page", action="store_true", help="only make the page of the rows that are there")
    options = parser.parse_args()
    if options.rounds < 1:
        parser.error(f"--rounds must be at least 1, got {options.rounds}")
    wp.config.log_level = max(wp.config.log_level, wp.LOG_WARNING)
    kept = StoredRows(options.out, "newton")
    cells = [(p, m, g) for g in options.gaps for m in options.meshes for p in options.particles]
    for number, (particles, meshes, gap) in enumerate(cells, start=1):
        known = {"particles": particles, "meshes": meshes, "gap": gap, "device": options.device}
        if options.page or kept.have(**known):
            continue
        row = measure(particles, meshes, gap, options.rounds, options.device)
        kept.add(row | {"device": options.device, "newton": newton.__version__, "note": options.note})
        reported = ", ".join(f"{way} {1 / share:.2f}" for way, share in row["share"].items())
        print(
            f"{number} of {len(cells)}: {particles:,} particles, {meshes} meshes, gap {gap:g}: times as fast: "
            f"{reported}",
            file=sys.stderr,
        )
    if not kept.rows:
        sys.exit(f"newton_map: there are no rows in {options.out}; run it without --page")
    reported = [word for word in sys.argv[1:] if word != "--page"]
    kept.write(page(kept, " ".join(["python", "benchmarks/newton_map.py", *reported])))
    if _is_map(kept):
        drawn(kept, options.out / "map.png")


if __name__ == "__main__":
    try:
        main()
    except wb.BoundingError as error:
        sys.exit(f"newton_map: {error}")
    except KeyboardInterrupt:
        sys.exit("newton_map: stopped; run it again, and it goes on where it was")
