"""The plan of ``docs/architecture.md`` holds: imports go down the floors and never in a circle, folders and files stay small.

Every import counts, wherever it stands: at the top of a file, inside a function, for type checkers only.
"""

import ast
import re
from pathlib import Path

import pytest

from warp_bounding.activations import ACTIVATIONS
from warp_bounding.bounders import METHODS
from warp_bounding.queries import QUERIES

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "warp_bounding"
# From the ground up; a folder or file imports what stands on lower floors, and nothing else.
FLOORS = (
    "errors version",
    "arithmetic",
    "runtime",
    "indicators",
    "arms solids",
    "geometry",
    "queries",
    "coordinates",
    "support_functions",
    "kernels",
    "activations",
    "networks",
    "certificates",
    "bounders",
    "proof",
    "evaluation",
    "training",
    "choice",
    "baking",
    "newton",
    "views",
    "cli",
    "__main__",
)
FLOOR = {name: floor for floor, names in enumerate(FLOORS) for name in names.split()}
MOST_FILES = 24  # of a folder
MOST_LINES = 400  # of a file


def parsed(folder: str) -> dict[str, ast.Module]:
    """The syntax trees of a folder's files, by module."""
    found = {}
    for path in sorted((ROOT / folder).rglob("*.py")):
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        found[name] = ast.parse(path.read_text(encoding="utf-8"))
    return found


def imported(tree: ast.Module, modules: set[str]) -> set[str]:
    """What a file imports, anywhere in it; of a package, the module where that is what is meant."""
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, "imports are absolute"
            names |= {
                f"{node.module}.{a.name}" if f"{node.module}.{a.name}" in modules else node.module for a in node.names
            }
    return names


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """The strongly connected components of more than one node (Tarjan)."""
    index, low, stack, on, found = {}, {}, [], set(), []

    def visit(v: str) -> None:
        index[v] = low[v] = len(index)
        stack.append(v)
        on.add(v)
        for w in graph[v]:
            if w not in index:
                visit(w)
                low[v] = min(low[v], low[w])
            elif w in on:
                low[v] = min(low[v], index[w])
        if low[v] == index[v]:
            component = []
            while True:
                w = stack.pop()
                on.discard(w)
                component.append(w)
                if w == v:
                    break
            if len(component) > 1:
                found.append(sorted(component))

    for v in graph:
        if v not in index:
            visit(v)
    return found


def graph_of(folder: str) -> dict[str, set[str]]:
    """Which of a folder's files each of them imports."""
    trees = parsed(folder)
    return {name: (imported(tree, set(trees)) & set(trees)) - {name} for name, tree in trees.items()}


def part(module: str) -> str:
    """The folder or file of the package that a module belongs to; empty for the package itself."""
    return module.partition(".")[2].partition(".")[0]


@pytest.mark.parametrize("folder", ["warp_bounding", "paper", "sims", "benchmarks"])
def test_no_circle(folder):
    assert circles(graph_of(folder)) == []


def test_imports_go_down():
    upwards = [
        f"{module} imports {other}"
        for module, others in graph_of("warp_bounding").items()
        for other in others
        if part(module) != part(other) and part(module) and not FLOOR[part(other)] < FLOOR[part(module)]
    ]
    assert upwards == []


def test_the_package_imports_nothing_of_the_checkout():
    for module, tree in parsed("warp_bounding").items():
        checkout = {"paper", "sims", "tests", "tools", "benchmarks", "notebooks"}
        assert not {n.partition(".")[0] for n in imported(tree, set())} & checkout, module


def test_every_part_has_a_floor():
    assert {part(module) for module in graph_of("warp_bounding")} - {""} == set(FLOOR)


def test_simulations_use_the_public_api():
    """What a file outside the package imports of it is in the ``__all__`` of the package itself, of ``warp_bounding.newton`` or of ``warp_bounding.views``."""
    for module, tree in parsed("sims").items():
        names = {n for n in imported(tree, set()) if n.partition(".")[0] == "warp_bounding"}
        allowed = {"warp_bounding", "warp_bounding.newton", "warp_bounding.views"}
        assert names <= allowed or module == "sims.__main__", module  # which is a command line like the package's


def folders() -> list[Path]:
    """Every folder with code that is kept."""
    tops = (PACKAGE, ROOT / "sims", ROOT / "benchmarks", ROOT / "tests")
    return sorted({path.parent for top in tops for path in top.rglob("*.py")})


def test_folders_are_small():
    sizes = {str(f.relative_to(ROOT)): len(list(f.glob("*.py"))) for f in folders()}
    assert {name: size for name, size in sizes.items() if size > MOST_FILES} == {}


def test_files_are_short():
    sizes = {str(p.relative_to(ROOT)): len(p.read_text(encoding="utf-8").splitlines()) for p in PACKAGE.rglob("*.py")}
    assert {name: size for name, size in sizes.items() if size > MOST_LINES} == {}


def compared_strings(tree: ast.Module) -> set[str]:
    """Text constants that something is compared with, or looked for among."""
    found = set()
    for node in ast.walk(tree):
        values = []
        if isinstance(node, ast.Compare):
            values = [node.left, *node.comparators]
        elif isinstance(node, ast.MatchValue):
            values = [node.value]
        for value in values:
            elements = value.elts if isinstance(value, ast.Tuple | ast.List | ast.Set) else [value]
            found |= {e.value for e in elements if isinstance(e, ast.Constant) and isinstance(e.value, str)}
    return found


def test_names_that_users_choose_are_objects():
    """Not even the registries compare a query's, an activation's or a method's name with a literal."""
    names, guilty = {*QUERIES, *ACTIVATIONS, *METHODS} - {"occupancy"}, {}  # which is also a key of arrays
    for module, tree in parsed("warp_bounding").items():
        if found := compared_strings(tree) & names:
            guilty[module] = sorted(found)
    assert guilty == {}


def documented() -> set[str]:
    """The files that the pages name, as paths from the root or from the package."""
    text = "".join(page.read_text(encoding="utf-8") for page in (ROOT / "docs").glob("*.md"))
    return set(re.findall(r"`((?:\w+/)*\w+\.py)", text))


def test_pages_name_files_that_exist():
    assert documented()
    assert [name for name in documented() if not any((top / name).is_file() for top in (ROOT, PACKAGE))] == []


def test_the_page_names_every_floor():
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    for name in FLOOR:
        assert re.search(rf"`{name}/?`", page), name
