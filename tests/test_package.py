"""The package as a whole: light to import, documented, its parts in order, its README in force."""

import ast
import importlib
import os
import re
import subprocess
import sys
from functools import cached_property
from pathlib import Path
from types import FunctionType

import pytest
from reading_order import PAGES

import warp_bounding as wb
from warp_bounding.errors import BounderError

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "warp_bounding"
HEAVY = ("torch", "trimesh", "pyvista", "matplotlib", "scipy", "typer", "PIL", "pxr")


def python(code: str) -> str:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip().splitlines()[-1]


def test_importing_is_light():
    listed = f"import sys; print([m for m in {HEAVY} if m in sys.modules])"
    assert python("import warp_bounding;" + listed) == "[]"
    assert python("import warp_bounding; dir(warp_bounding);" + listed) == "[]"


def test_loading_and_asking_is_light(tmp_path):
    from bounding_shapes import fitted

    path = tmp_path / "b.safetensors"
    fitted("mlp", "blob").save(path)
    code = (
        f"import warp_bounding as wb, numpy as np, sys; b = wb.load({str(path)!r}, device='cpu'); "
        "n = int(b.query(np.full((5, 3), np.nan, np.float32)).numpy().sum()); "
        f"print(n, [m for m in {HEAVY} if m in sys.modules])"
    )
    assert python(code) == "5 []"


def test_public_names_exist_and_are_documented():
    assert set(dir(wb)) == set(wb.__all__)
    for name in wb.__all__:
        thing = getattr(wb, name)
        if name not in ("__version__", "DISTANCES", "METHODS"):
            assert thing.__doc__, name
            assert not thing.__doc__.startswith(f"{name}("), f"{name} has only what dataclass writes"
    for method, kind in [*wb.METHODS.items(), *wb.DISTANCES.items()]:
        assert kind.method == method
        assert kind.__doc__
    with pytest.raises(AttributeError, match="nothing_of_the_kind"):
        _ = wb.nothing_of_the_kind


def modules():
    for path in sorted(PACKAGE.rglob("*.py")):
        yield path, ast.parse(path.read_text())


def imports_torch(statements) -> bool:
    names = {a.name for n in statements if isinstance(n, ast.Import) for a in n.names}
    names |= {n.module for n in statements if isinstance(n, ast.ImportFrom)}
    return any(name.split(".")[0] == "torch" for name in names)


def test_torch_lives_in_training_only():
    """Activations import it where training asks them for something, in a function; nobody else does."""
    for path, tree in modules():
        part = path.relative_to(PACKAGE).parts[0]
        assert not imports_torch(ast.walk(tree)) or part in ("training", "activations"), path
        assert not imports_torch(tree.body) or part == "training", path


def test_every_module_says_what_it_is_and_what_it_gives():
    for path, tree in modules():
        assert ast.get_docstring(tree), path
        names = [
            t.id
            for n in tree.body
            if isinstance(n, (ast.Assign, ast.AnnAssign))
            for t in (n.targets if isinstance(n, ast.Assign) else [n.target])
            if isinstance(t, ast.Name)
        ]
        if names or path.name != "__init__.py":  # a package of modules only says what they are
            assert "__all__" in names, path


def test_every_public_method_is_documented_by_its_class_or_a_base():
    described = (classmethod, staticmethod, property, cached_property, FunctionType)
    for path, _ in modules():
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        try:
            module = importlib.import_module(name)
        except (ImportError, BounderError):  # of an extra that is not installed
            continue
        for kind in vars(module).values():
            if not isinstance(kind, type) or kind.__module__ != name or kind.__name__.startswith("_"):
                continue
            for member, thing in vars(kind).items():
                if isinstance(thing, described) and not member.startswith("_"):
                    texts = [getattr(vars(base).get(member), "__doc__", None) for base in kind.__mro__]
                    assert any(texts) or getattr(thing, "__name__", member) != member, (
                        f"{name}.{kind.__name__}.{member}"
                    )


def test_versions_agree():
    assert re.fullmatch(r"\d+\.\d+\.\d+.*", wb.__version__)
    assert f"\n## [{wb.__version__}] - " in (ROOT / "CHANGELOG.md").read_text()
    assert (PACKAGE / "py.typed").exists()


@pytest.mark.skipif(not (ROOT / "README.md").exists(), reason="there is no README.md yet")
def test_readme_and_guide_compile_and_name_what_exists():
    text = "".join(page.read_text() for page in PAGES)
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert blocks
    for block in blocks:
        tree = compile(block, "README.md", "exec", ast.PyCF_ONLY_AST)
        for node in ast.walk(tree):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "wb":
                assert hasattr(wb, node.attr), f"a page uses wb.{node.attr}"


@pytest.mark.skipif(not (ROOT / "README.md").exists(), reason="there is no README.md yet")
def test_the_guide_names_every_method():
    section = (ROOT / "docs/guide/methods.md").read_text()
    named = re.findall(
        r"`([^`]+)`", "".join(row.split("|")[1] for row in section.splitlines() if row.startswith("| `"))
    )
    assert {name for name in named if "+" not in name} - {"method="} == set(wb.METHODS) | set(wb.DISTANCES)
