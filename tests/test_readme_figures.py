"""The figures of the README and of the pages it leads to are those of the files in ``results``: tables cell by cell, sentences by what they must say.

What no file holds is not checked: what a query costs, the batch against torch, the dragon's rays.
"""

import csv
import json
import re
import statistics
from functools import partial

import pytest
from reading_order import PAGES, ROOT

from paper.columns import CASCADE, COLUMNS, DISTANCE, LOCAL, PAPER, VARIANTS
from paper.pages.means import Means
from paper.rows import Row

TEXT = "\n".join(page.read_text() for page in PAGES)
PROSE = " ".join(TEXT.split())
RESULTS = ROOT / "results"
EXACT, SAMPLED = "exact truth", "the paper's, sampled truth"
NOTE = "¹"  # that none of the objects is proven


def table(head: str) -> list[list[str]]:
    """Cells of the only table whose first line has these words, without its head."""
    (found,) = (block for block in re.findall(r"(?:^\|.*\n)+", TEXT, re.MULTILINE) if head in block.splitlines()[0])
    return [[cell.strip() for cell in line.strip().strip("|").split("|")] for line in found.splitlines()[2:]]


def plain(cell: str) -> str:
    """A cell without bold, code and notes."""
    return re.sub(r"[*`¹]", "", cell).strip()


def test_points():
    with (RESULTS / "points/points.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row[0][:2] for row in table("ours, proven")] == ["2D", "3D", "4D"]
    for shown, ndim in zip(table("ours, proven"), "234", strict=True):
        own = [row for row in rows if row["dimension"] == ndim]
        assert shown[0].split(", ")[1].split()[0] == str(len(own))
        assert plain(shown[2]) == f"{sum(float(row['fp_rate']) for row in own) / len(own):.2f}"
        assert shown[3] == str(PAPER["mlp"][4 * (int(ndim) - 2)])
        assert shown[4] == str(sum(int(row["fn"]) for row in own))
        assert {row["certificate"] for row in own} == {"proven"}
    flat = max(float(row["fp_cost_of_proof"]) for row in rows if row["dimension"] != "4")
    deep = max(float(row["fp_cost_of_proof"]) for row in rows if row["dimension"] == "4")
    assert f"The proof costs at most {flat:.2f} points of these in 2D and 3D, {deep:.2f} in 4D" in PROSE


def test_meshes():
    rows = [json.loads(line) for line in (RESULTS / "meshes/meshes.jsonl").read_text().splitlines()]
    found, names = {(row["label"], row["mesh"]): row for row in rows}, list(dict.fromkeys(row["mesh"] for row in rows))
    assert f"| meshes | bytes | {' | '.join(names)} |" in TEXT
    for shown, _, *cells in table("| meshes |"):
        label = plain(shown).replace(", ", " ").removesuffix(" leaves").removesuffix(" cells")
        assert [plain(cell) for cell in cells] == [f"{found[label, name]['fp_rate']:.2f}" for name in names]
    ratios = [
        found[f"bvh {leaves}", name]["fp_rate"] / found[f"mlp {hidden}", name]["fp_rate"]
        for leaves, hidden in ((64, "24-24"), (300, "50-50"))
        for name in names
        if name != "bear"
    ]
    assert f"a network is {min(ratios):.1f} to {max(ratios):.1f} times as tight as a hierarchy" in PROSE
    assert {row["certificate"] for row in rows} == {"proven"}
    assert not any(row["fn"] or row["missed"] for row in rows)
    assert min(row["attacked"] for row in rows) > 10_000_000
    below = [
        found[label, name]["nanoseconds"]
        for label in ("bvh 64", "bvh 300", "voxels 192", "mlp 16-16", "mlp 24-24", "mlp 50-50")
        for name in names
    ]
    assert f"costs {min(below):.0f} to {max(below):.0f} ns" in PROSE


@pytest.fixture(scope="module")
def rows():
    lines = (RESULTS / "table1/table1.csv").read_text().splitlines()[1:]
    return [Row.parse(line) for line in lines]


@pytest.fixture(scope="module")
def shown() -> dict[str, dict[str, list[str]]]:
    """What is shown of Table 1: cells by protocol and row."""
    parts, found = {EXACT: {}, SAMPLED: {}}, table("| | 2D point |")
    protocol = None
    for label, *cells in found:
        if label.startswith("**"):
            protocol = plain(label)
        else:
            parts[protocol][plain(label).split(",")[0]] = cells
    return parts


@pytest.mark.parametrize(("part", "protocol"), [(EXACT, "exact"), (SAMPLED, "sampled")])
def test_table1(rows, shown, part, protocol):
    means = Means(rows, protocol)
    assert len(shown[part]) > 2
    for name, cells in shown[part].items():
        for cell, column in zip(cells, COLUMNS, strict=True):
            if name.startswith("the paper"):
                assert part == SAMPLED
                assert float(plain(cell)) == column.paper_network
                continue
            (variant,) = (v for v in VARIANTS if v.label == name)
            mean = means.cells.get((variant, column))
            assert plain(cell) == ("" if mean is None else f"{mean.fp_rate:.2f}"), (name, column.title)
            assert (mean.objects if NOTE in cell else 0) == (0 if mean is None else mean.unproven), (name, column.title)


def test_what_the_paper_is_compared_with_has_its_protocol(rows, shown):
    means = Means(rows, "sampled")
    (paper,) = (cells for name, cells in shown[SAMPLED].items() if name.startswith("the paper"))
    ahead = 0
    for column, *ours, theirs in zip(
        COLUMNS, *(shown[SAMPLED][name] for name in (CASCADE, DISTANCE)), paper, strict=True
    ):
        lower = means.best_network(column)[1].fp_rate < column.paper_network
        assert lower == any("**" in cell for cell in ours) != ("**" in theirs), column.title
        ahead += lower
    assert f"the cascade and `distance` are ahead in {ahead} of {len(COLUMNS)} columns" in PROSE
    assert "the paper's best network" not in "".join(shown[EXACT])


def test_the_short_table_is_part_of_the_long_one(shown):
    short = {plain(label).split(",")[0]: cells for label, *cells in table("| mean of all objects |")}
    assert short
    assert all(cells == shown[SAMPLED][name] for name, cells in short.items())


def test_what_is_said_of_distances_in_table1(rows):
    """All proven, and in which time."""
    own = [row for row in rows if row.method == DISTANCE]
    assert {row.certificate for row in own} == {"proven"}
    seconds = {n: [row.proof_seconds for row in own if row.dimension == n] for n in (3, 4)}
    told = f"3D in {min(seconds[3]):.0f} to {max(seconds[3]):.0f} s and 4D in up to {max(seconds[4]):.0f}"
    assert told in PROSE
    rays = [row for row in rows if (row.dimension, row.query, row.protocol) == (3, "ray", "exact")]
    one, many = ([row for row in rays if row.method == method and row.leaves is None] for method in ("mlp", LOCAL))
    means = [sum(row.fp_rate for row in own) / len(own) for own in (one, many)]
    assert len(one) == len(many) == 9
    assert f"takes the network's {means[0]:.2f} % in 3D to {means[1]:.2f}, not proven either" in PROSE
    assert "proven" not in {row.certificate for row in (*one, *many)}


def test_what_is_said_of_table1(rows):
    assert f"other of the {len(rows):,} cells but those of `occupancy`" in PROSE
    assert {row.method for row in rows if row.fn} == {"occupancy"}
    assert {row.samples for row in rows} == {400_000}
    source = (ROOT / "benchmarks/protocol_check.py").read_text()
    figures = [float(x) for x in re.search(r'"aabb": \((.*?)\)', source).group(1).split(",")]
    published = PAPER["aabb"]
    says = f"`AABox` has {figures[6]} % in 3D and {figures[10]} % in 4D, where the paper says {published[6]} and {published[10]}"
    assert says in PROSE
    bvh = {c: m for (v, c), m in Means(rows, "sampled").cells.items() if v.label == "bvh"}
    planes = [f"{bvh[column].fp_rate:.2f}" for column in (COLUMNS[6], COLUMNS[10])]
    assert f"has {planes[0]} % in 3D and {planes[1]} % in 4D" in PROSE


@pytest.fixture(scope="module")
def demos() -> dict[str, dict[tuple[str, str], dict]]:
    """Runs by demo, then by section and bounder, with calls a step."""
    found = {}
    for path in RESULTS.glob("demos/*.json"):
        demo = json.loads(path.read_text())
        found[path.stem] = {
            (run["section"], run["bounder"]): run | {"calls": run["narrow_calls"] / demo["steps"]}
            for run in demo["runs"]
        }
    return found


def test_demos(demos):
    """Of the box and the k-DOP, and of both worlds, the one that calls less and the sum."""
    lines = {plain(line[0]): line[2:] for line in table("| narrow phase |")}
    sections = {"particles": ["containment"], "cloth": [""], "path": ["rooms", "maze"], "shadows": [""]}
    sections["arm"] = ["Planar arm, 3 joints", "Planar arm, 4 joints"]
    assert lines.keys() == sections.keys()
    for name, parts in sections.items():
        runs = demos[name]

        def calls(*bounders, runs=runs, parts=parts):
            known = [bounder for bounder in bounders if (parts[0], bounder) in runs]
            return min(sum(runs[part, bounder]["calls"] for part in parts) for bounder in known)

        boxes = ("aabb", "kdop", *(["moving aabb"] if name == "particles" else []))
        none, box, mlp, occupancy = lines[name]
        assert none == f"{calls('none'):,.0f}"
        assert box.split()[0] == f"{calls(*boxes):,.0f}"
        assert mlp == f"{calls('mlp'):,.0f}"
        lost = "collisions" if name in ("path", "arm") else "missed"
        assert occupancy.split()[0] == f"{sum(runs[part, 'occupancy'][lost] for part in parts):,}"
        for run in runs.values():
            if run["certificate"] == "proven":
                assert run["identical"]
                assert run["missed"] == 0


def test_what_is_said_of_arms(demos):
    three, four, meshes, trees = (
        {name: run for (section, name), run in demos["arm"].items() if section == f"Planar arm, {which}"}
        for which in ("3 joints", "4 joints", "4 joints, meshes", "4 joints, meshes, RRT-Connect")
    )
    fewer = [own["none"]["calls"] / own["mlp"]["calls"] for own in (three, four, meshes)]
    time = meshes["mlp"]["ms_step"] / meshes["none"]["ms_step"]
    less, longer = (trees["none"]["calls"] / trees["mlp"]["calls"], trees["mlp"]["ms_step"] / trees["none"]["ms_step"])
    assert f"{less:.1f} times fewer checks, and {100 * longer:.0f} % of the time" in PROSE
    rates = [[f"{own[name]['fp_rate']:.1f}" for name in ("mlp", "aabb", "bvh")] for own in (three, four)]
    assert f"Three joints: {fewer[0]:.0f} times fewer checks than without, {rates[0][0]} % false positives" in PROSE
    assert f"the box has {rates[0][1]}, a hierarchy of boxes {rates[0][2]}" in PROSE
    assert f"Four joints: {fewer[1]:.1f} times fewer, {rates[1][0]} % ({rates[1][1]} and {rates[1][2]})" in PROSE
    assert f"four joints {fewer[2]:.1f} times fewer checks, and the plan takes {100 * time:.0f} % of the time" in PROSE


def test_what_is_said_of_a_generative_model(demos):
    two, three, ten = (
        {name: run for (section, name), run in demos["digits"].items() if section.startswith(f"{numbers} latent")}
        for numbers in (2, 3, 10)
    )
    rates, faster = zip(*((own["mlp"]["fp_rate"], own["mlp"]["faster"]) for own in (two, three)), strict=True)
    assert two["mlp"]["certificate"] == three["mlp"]["certificate"] == "proven"
    assert f"({rates[0]:.1f} and {rates[1]:.1f} % false positives of codes and pixels; {faster[0]:.1f} and {faster[1]:.1f} times as fast)" in PROSE  # fmt: skip
    assert ten["mlp"]["asked"] == 100.0


def test_what_is_said_of_an_arm_with_itself():
    told = json.loads((RESULTS / "self-collision/self-collision.json").read_text())
    alone, rows = told["alone"], told["rows"]
    assert alone["certificate"] == "proven"
    assert all(row["identical"] for row in rows)
    pairs = list(zip(rows[::2], rows[1::2], strict=True))
    fewer = [none["checks"] / both["checks"] for none, both in pairs]
    time = [100 * both["step_ms"] / none["step_ms"] for none, both in pairs]
    assert f"({alone['bytes'] / 1000:.1f} kB, proven, {alone['fp_rate']:.1f} % false positives)" in PROSE
    assert f"In two cells {fewer[0]:.1f} and {fewer[1]:.1f} times fewer checks, and the plan takes {time[0]:.0f} and {time[1]:.0f} % of the time" in PROSE  # fmt: skip


def test_what_is_said_of_bodies_that_deform():
    rows = [json.loads(line) for line in (RESULTS / "deforming/deforming.jsonl").read_text().splitlines()]
    assert not any(row["missed"] or row.get("attack_missed") for row in rows)
    labels = ("learned-kdop", "box, refitted", "mlp", "mlp, 1,024 parts")
    planes, boxes, networks, parts = ([row for row in rows if row["label"] == label] for label in labels)
    left = [f"{row['left']:.1f}" for row in (*planes, *boxes, *networks, *parts)]
    assert f"leaves {left[0]} and {left[1]} % of the particles around a finger and a ball, a box that is refitted to each pose {left[2]} and {left[3]} %" in PROSE  # fmt: skip
    time = [[one["step_ms"] / other["step_ms"] for one, other in zip(own, boxes, strict=True)] for own in (planes, networks)]  # fmt: skip
    assert f"a step takes {time[0][0]:.2f} and {time[0][1]:.2f} of its time" in PROSE
    assert f"leaves {left[5]} % around the ball, and a step takes {time[1][1]:.2f}." in PROSE
    assert f"one threshold leaves {left[4]} %; one for each of 1,024 parts (`thresholds=1024`) leaves {left[6]} " in PROSE  # fmt: skip


def test_what_is_said_of_own_queries():
    rows = [json.loads(line) for line in (RESULTS / "own-queries/own-queries.jsonl").read_text().splitlines()]
    usual, own = ([r["calls"] for r in rows if r["label"] == label] for label in ("usual", "to its own queries"))
    fewer = statistics.geometric_mean(a / b for a, b in zip(usual, own, strict=True))
    assert f"{fewer:.2f} times fewer calls of the narrow phase in the rain" in PROSE


PLANNED = ("none", "mlp", "bvh", "mlp+inside", "bvh+inside", "distance", "distance-grid")


def test_distances():
    told = map(json.loads, (RESULTS / "distances/distances.jsonl").read_text().splitlines())
    rows = {row["label"].split(",")[0]: row for row in told}
    lines = table("| distances |")
    assert len(lines) == 6
    for name, size, *cells in lines:
        row = rows[plain(name).replace(",", "")]
        assert size == (f"{row['bytes']} B" if row["bytes"] < 1000 else f"{row['bytes'] / 1000:.1f} kB")
        rates = [row["rates"][place] for place in (0, 2, 4)]
        assert cells[:4] == [f"{rate:.2f}" for rate in (*rates, row["segments"])]
        assert cells[4:] == [f"{row['ns_point']:.1f}", f"{row['ns_segment']:.0f}"]
        assert row["certificate"] == "proven"


def test_what_users_have_already():
    told = map(json.loads, (RESULTS / "speed/rivals/rivals.jsonl").read_text().splitlines())
    rows = {(row["group"].split()[0], row["contestant"]): row for row in told}
    small, large = (rows["points", f"mlp {size}"]["ns"] for size in ("24-24", "50-50"))
    torch = [rows["points", f"mlp {size}, torch"]["times"] for size in ("24-24", "50-50")]
    assert f"{small:.1f} ns with a network of 24-24 neurons and {large:.1f} with 50-50" in PROSE
    assert f"torch takes {torch[0]:.1f} and {torch[1]:.1f} times as long" in PROSE
    trees = [rows[group, "bvh 256, wp.Bvh of the same boxes"]["times"] for group in ("points", "rays")]
    assert f"`wp.Bvh` takes {trees[0]:.1f} times as long" in PROSE
    assert f"for points and {trees[1]:.1f} times for rays" in PROSE
    exact = rows["points", "wp.mesh_query_point, exact"]["ns"], rows["rays", "wp.mesh_query_ray_anyhit, exact"]["ns"]
    embree = rows["rays", "trimesh with Embree, exact, one core"]["ns"]
    assert f"takes {exact[0]:.0f} ns a point and {exact[1]:.0f} a ray, trimesh with Embree {embree:.0f} a ray" in PROSE
    cull, own = (rows["pairs", name] for name in ("cull, mlp", "Newton's pass"))
    assert f"A cull of Newton's {cull['count']:,} pairs takes {cull['ns'] * cull['count'] / 1e6:.1f} ms" in PROSE
    assert f"its own pass {own['ns'] * own['count'] / 1e6:.1f}" in PROSE
    labels = ", ".join(
        f"{1e3 / rows['labels', kind]['ns']:.0f} ({name})" for kind, name in (("ray", "rays"), ("plane", "planes"))
    )
    assert f"{labels} and {1e3 / rows['labels', 'box']['ns']:.0f} (boxes) million queries a second" in PROSE
    functions = [rows["points", f"mlp {size}, function, one core"]["ns"] for size in ("24-24", "50-50")]
    assert f"takes {functions[0]:.0f} and {functions[1]:.0f} ns there where its answers come at random" in PROSE
    alike = [rows["points", f"mlp {size}, function, one core, all maybe"]["ns"] for size in ("24-24", "50-50")]
    assert f"and {alike[0]:.0f} and {alike[1]:.0f} where all are alike" in PROSE


def test_what_is_said_of_the_map_of_newtons_pass():
    """How many times as fast: ``boxes`` without bounders, ``distance`` with them, ``cores`` with the cull on all cores."""
    rows = [json.loads(line) for line in (RESULTS / "newton/newton.jsonl").read_text().splitlines()]
    text = " ".join((ROOT / "docs/newton.md").read_text().split())

    def times(*kinds, **wanted):
        own = [row for row in rows if all(row[key] in values for key, values in wanted.items())]
        return [1 / row["share"][kind] for kind in kinds for row in own]

    many, near, one = {"particles": (50_000, 100_000), "meshes": (16, 64)}, (0.01, 0.05), {"meshes": (1,)}
    fast, wide = times("distance", **many, gap=near), times("distance", **many, gap=(0.2,))
    most = max(times("cores", **many, gap=near))
    assert f"is {min(fast):.1f} to {max(fast):.1f} times as fast at gaps of 0.01 and 0.05 m" in text
    assert f"(up to {most:.1f} with the cull on two), and {min(wide):.1f} to {max(wide):.1f} times at 0.2 m" in text
    assert max(times("distance", particles=(10_000,), meshes=(1, 4))) < 1.49
    assert min(times("distance", particles=(10_000,), meshes=(16, 64))) > 1.49
    few = times("distance", particles=(1000,))
    assert f"with 1,000 there is little to gain ({min(few):.1f} to {max(few):.2f})" in text
    with_, without = (times(kind, particles=(100_000,), **one, gap=near) for kind in ("distance", "boxes"))
    assert f"{with_[0]:.2f} and {with_[1]:.2f} against {without[0]:.2f} and {without[1]:.2f}" in text
    small = times("boxes", "distance", particles=(1000,), **one)
    assert f"it is {100 * (max(small) - 1):.0f} % faster to {100 * (1 - min(small)):.0f} % slower" in text
    for kind, told in (("boxes", "0.3"), ("distance", "0.1")):
        (row,) = (row for row in rows if (row["particles"], row["meshes"], row["gap"]) == (100_000, 64, 0.01))
        assert f"{100 * row['left'][kind] / row['pairs']:.1f}" == told


def field_ratios() -> tuple[list[float], list[float]]:
    """Of many meshes, at each contact gap: how many times as fast with a bounder of distances, and with the best one of points on one thread."""
    rows = json.loads((RESULTS / "demos/cloth.json").read_text())["field"]
    found = [{entry["bounder"]: entry["ratio"] for entry in row["bounders"]} for row in rows]
    others = ({k: v for k, v in row.items() if k != "distance" and "all cores" not in k} for row in found)
    return [row["distance"] for row in found], [max(row.values()) for row in others]


def test_what_is_said_of_the_demos(demos):
    def share(section, bounder):
        """Of the time of broad and narrow phase without a broad phase, in %."""
        runs = [demos["particles"][section, name] for name in (bounder, "none")]
        one, none = (run["ms_broad"] + run["ms_narrow"] for run in runs)
        return f"{100 * one / none:.0f}"

    deep, near = partial(share, "containment"), partial(share, "contact")
    rates = {name: run["fp_rate"] for (_, name), run in demos["particles"].items() if run["fp_rate"]}
    path = demos["path"]
    every = {name: sum(path[part, name]["calls"] for part in ("rooms", "maze")) for name in PLANNED}
    fewer = {name: f"{every['none'] / calls:.0f}" for name, calls in every.items()}
    spent = {name: sum(path[part, name]["ms_broad"] for part in ("rooms", "maze")) for name in PLANNED}
    price = {name: 1000 * spent[name] / (every["none"] - every[name]) for name in PLANNED[1:]}
    porous = {name: run for (section, name), run in demos["particles"].items() if section == "porous"}
    seldom, often = (demos["particles"]["containment", name] for name in ("distance", "mlp"))
    check = 1000 * sum(path[part, "none"]["ms_narrow"] for part in ("rooms", "maze")) / every["none"]
    cloth = {name: run["ms_broad"] + run["ms_narrow"] for (_, name), run in demos["cloth"].items()}
    steps = {name: run["ms_step"] for (_, name), run in demos["cloth"].items()}
    best, of_points = ([f"{ratio:.2f}" for ratio in ratios] for ratios in field_ratios())
    shadows = {name: run["calls"] for (_, name), run in demos["shadows"].items()}
    passed, whole = (times["none"] / times["mlp"] for times in (cloth, steps))
    sentences = [
        f"{deep('moving aabb')} % are left with the box that is refitted every step, {deep('aabb+mlp')} % with `aabb+mlp` "
        f"(11 kB), {deep('bvh-1500')} % with a hierarchy of 1,500 boxes (72 kB), and {deep('voxels')} % with `voxels`",
        f"{rates['mlp']:.1f} % false positives against the moving mesh itself, the hierarchy of its memory (`bvh`) "
        f"{rates['bvh']:.1f}, that of 1,500 boxes {rates['bvh-1500']:.1f}, `voxels` {rates['voxels']:.1f}",
        f"against the moving bunny of the demo itself, {rates['bvh']:.1f} against the network's {rates['mlp']:.1f} %",
        f"Refitted box {near('moving aabb')} %, `learned-kdop` {near('learned-kdop')} %, `learned-kdop+mlp` "
        f"{near('learned-kdop+mlp')} %, `aabb+mlp` {near('aabb+mlp')} %, `voxels` {near('voxels')} %",
        f"part of its {rates['mlp']:.1f} %",
        f"with `mlp` the pass is {passed:.2f} times as fast, the whole step {whole:.2f}",
        f"{best[0]}, {best[1]} and {best[2]} times as fast with `distance` at contact gaps",
        f"({of_points[0]}, {of_points[1]} and {of_points[2]} with the best of these)",
        f"({shadows['distance']:,.0f} a picture, the hierarchy {shadows['bvh']:,.0f})",
        f"{fewer['mlp']} times fewer exact checks with `mlp`, {fewer['bvh']} with `bvh`",
        f"{fewer['mlp+inside']} times fewer with `mlp+inside`, {fewer['bvh+inside']} with `bvh+inside`",
        f"a check takes {check:.2f} µs",
        f"{fewer['distance']} times fewer checks, at {price['distance']:.2f} µs for each that it saves",
        f"{fewer['distance-grid']} times fewer, at {price['distance-grid']:.2f} µs",
        f"({price['bvh']:.2f} µs for each check that it saves); networks save time where a check costs more than {price['mlp']:.0f}",
        f"{porous['mlp+inside']['calls']:,.0f} calls a step with both, {porous['mlp']['calls']:,.0f} with `mlp` alone",
        f"{100 * seldom['asked'] / 15e6:.0f} % of the questions, {seldom['calls']:,.0f} calls a step. On a CPU that does not pay here, "
        f"{seldom['ms_broad']:.1f} ms a step against {often['ms_broad']:.1f}",
        f"a step takes {porous['mlp+inside']['ms_step']:.1f} ms, {porous['mlp']['ms_step']:.0f} and {porous['none']['ms_step']:.0f}",
    ]
    assert [sentence for sentence in sentences if sentence not in PROSE] == []


def test_what_is_said_of_a_gpu():
    rows = [json.loads(line) for line in (RESULTS / "speed/rivals-cuda/rivals.jsonl").read_text().splitlines()]
    ns = {(row["group"], row["contestant"]): row["ns"] for row in rows}
    page = (ROOT / "docs/tables.md").read_text()
    part = page[page.index("## On a GPU") :]
    shown = [re.findall(r"[0-9]+\.[0-9]{3}", line) for line in part.splitlines() if line.startswith("| ")]
    tree = ", wp.Bvh of the same boxes"
    expected = [[("points", "kdop"), ("rays", "kdop")]]
    expected += [[(g, f"bvh {n}{end}") for g in ("points", "rays") for end in ("", tree)] for n in (64, 256)]
    expected += [[("points", "mlp 24-24"), ("points", "mlp 24-24, torch")]]
    expected += [[("points", "mlp 50-50"), ("points", "mlp 50-50, torch"), ("rays", "mlp 50-50")]]
    expected += [[("points", "wp.mesh_query_point, exact"), ("rays", "wp.mesh_query_ray_anyhit, exact")]]
    assert [cells for cells in shown if cells] == [[f"{ns[key]:.3f}" for key in line] for line in expected]
    told = [json.loads(line) for line in (RESULTS / "newton/cuda/newton.jsonl").read_text().splitlines()]
    few, even, many = sorted(told, key=lambda row: row["particles"])
    newton = " ".join((ROOT / "docs/newton.md").read_text().split())
    assert f"10,000 particles lose ({1 / few['share']['distance']:.1f} times as fast)" in newton
    assert 0.95 < 1 / even["share"]["distance"] < 1.05
    ms = [f"{many['ms'][way]:.2f}" for way in ("distance", "boxes", "none")]
    assert f"the pass takes {ms[0]} ms with bounders, {ms[1]} with boxes alone and {ms[2]} without" in newton


def test_what_is_said_of_proofs():
    with (RESULTS / "proofs/proofs.csv").open() as file:
        rows = list(csv.DictReader(file))
    missed = sum(int(row["missed_sampled"]) for row in rows)
    prover = sum(row["found_by"] == "prover" for row in rows if int(row["missed_sampled"]))
    zero = [row for row in rows if row["missed_zero"]]
    assert f"of the [{len(rows)} networks](../results/proofs/README.md)" in PROSE
    assert f"**{missed} had a false negative** that a search then found, {prover} of them the prover's" in PROSE
    assert f"{sum(int(row['missed_zero']) for row in zero)} of {len(zero)}" in PROSE


def test_what_a_query_costs():
    with (RESULTS / "speed/speed.csv").open() as file:
        told = [row for row in csv.DictReader(file) if row["dimension"] == "3" and row["space"] == "geometric"]
    rows = {(row["query"], row["method"]): row for row in told}
    methods = ("aabb", "kdop", "learned-kdop", "bvh", "mlp-early", "mlp")
    lines = table("`learned-kdop` | `bvh`, 11 kB | `mlp-early`, 12 kB | `mlp`, 11 kB")
    assert [line[0] for line in lines] == ["point", "ray", "plane", "box"]
    for query, *cells in lines:
        for method, cell in zip(methods, cells, strict=True):
            row = rows[query, method]
            ratio = "" if method == "mlp" else f" ({float(row['ratio']):.2f})"
            assert cell == f"{float(row['ns']):.1f}{ratio}"


def test_what_is_said_of_early_exits():
    exits = json.loads((RESULTS / "speed/speed.json").read_text())["cpu"]["early_out"]
    gains = sorted(column["gain"] for column in exits.values())
    cheap = sum(column["fp_early"] <= 1.2 * column["fp_mlp"] for column in exits.values())
    assert gains[0] > 1
    assert len(gains) == 12
    assert (
        f"in all twelve columns, {gains[0]:.2f} to {gains[-1]:.2f} times (3D rays: {exits['3d-ray']['gain']:.2f})"
        in PROSE
    )
    assert cheap == 10
    assert "In ten of them that costs at most a fifth more false positives" in PROSE
