"""The package as a whole is light to import."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import warp_bounding as wb

ROOT = Path(__file__).parents[1]
HEAVY = ("torch", "trimesh", "pyvista", "matplotlib", "scipy", "typer", "PIL", "pxr")


def python(code: str) -> str:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip().splitlines()[-1]


def test_importing_loading_and_asking_is_light(tmp_path):
    from bounding_shapes import fitted

    path = tmp_path / "b.safetensors"
    fitted("mlp", "blob").save(path)
    code = (
        f"import warp_bounding as wb, numpy as np, sys; dir(wb); b = wb.load({str(path)!r}, device='cpu'); "
        "n = int(b.query(np.full((5, 3), np.nan, np.float32)).numpy().sum()); "
        f"print(n, [m for m in {HEAVY} if m in sys.modules])"
    )
    assert python(code) == "5 []"


def test_help_is_quick_and_imports_no_library():
    code = "import sys; from warp_bounding.cli import main\ntry: main(['info', '--help'])\nexcept SystemExit: pass\n"
    code += "print([name for name in ('warp', 'torch', 'scipy', 'numpy') if name in sys.modules])"
    assert python(code) == "[]"


@pytest.mark.parametrize("name", ["union", "hierarchy", "load_indicator", "bake", "IndicatorMesh"])
def test_names_of_earlier_releases_say_what_to_use(name):
    with pytest.raises(AttributeError, match=f"wb.{name} is gone: take wb."):
        getattr(wb, name)
