"""The package as a whole: light to import, and documented."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import warp_bounding as wb

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


def test_versions_agree():
    assert re.fullmatch(r"\d+\.\d+\.\d+.*", wb.__version__)
    assert f"\n## [{wb.__version__}] - " in (ROOT / "CHANGELOG.md").read_text()
    assert (PACKAGE / "py.typed").exists()
