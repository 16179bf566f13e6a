"""What is built is well, what is wrong with it is found, and a clean environment sees what a wheel asks for and nothing
else."""

import re
import zipfile
from pathlib import Path

import distributions
import environments
import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> tuple[Path, Path]:
    """The wheel and the sdist."""
    return distributions.build(ROOT, tmp_path_factory.mktemp("dist"), isolated=False)


def test_what_is_built_is_well_and_repeatable(built, tmp_path):
    assert distributions.problems(*built, ROOT) == []
    again = distributions.build(ROOT, tmp_path, isolated=False)
    assert [path.read_bytes() for path in again] == [path.read_bytes() for path in built]
    metadata = distributions.metadata_of(built[0])
    assert "](docs/" not in metadata.get_payload()  # links and pictures of the README are words
    asked = metadata.get_all("Requires-Dist")
    names, core = ({re.match(r"[\w.-]+", r)[0] for r in asked if "extra ==" not in r or more} for more in (True, False))
    assert core == {"numpy", "rich", "safetensors", "scipy", "typer", "warp-lang"}
    pinned = set(re.findall(r"^([\w.-]+)==", (ROOT / "constraints.txt").read_text(), re.MULTILINE))
    assert names <= pinned  # no set-up depends on the day it is made


def test_what_is_wrong_with_a_wheel_is_found(built, tmp_path):
    files = distributions.contents(built[0])
    (metadata,) = (name for name in files if name.endswith("/METADATA"))
    (licence,) = (name for name in files if "/licenses/" in name)
    del files[licence], files["warp_bounding/py.typed"], files["warp_bounding/choice.py"]
    files |= {"sims/base.py": b"", "warp_bounding/version.py": b"", "warp_bounding/a.py": b"'/" + b"home/me/x'"}
    files["warp_bounding/b.py"] = b"#" * distributions.LARGEST
    files[metadata] = files[metadata].replace(b"Version: 0", b"Version: none-0") + b"\n[there](docs/guide.md)\n"
    with zipfile.ZipFile(spoilt := tmp_path / built[0].name, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    found = "\n".join(distributions.problems(spoilt, built[1], ROOT))
    for said in (
        "the wheel lacks the licence",
        "the wheel lacks warp_bounding/py.typed",
        "the wheel lacks warp_bounding/choice.py",
        "sims/base.py does not belong in the wheel",
        "warp_bounding/version.py is not the checkout's",
        "warp_bounding/a.py names a folder of a machine",
        "bytes, 2,000,000 at most",
        "versions differ: none-0",
        "the description leads to 'docs/guide.md'",
        "twine: ",
    ):
        assert said in found, said


def test_what_is_not_asked_for_is_not_seen(built, tmp_path):
    environment = environments.linked(tmp_path / "env", built[0])
    code = "from importlib.util import find_spec as f; print([n for n in ('numpy', 'warp', 'torch', 'pytest') if f(n)])"
    assert environment.run(["python", "-c", code], tmp_path, seconds=60).stdout.strip() == "['numpy', 'warp']"
    asked = ["numpy>=1.26", "pytest>=9; extra == 'dev'"]
    assert set(environments.needed(asked)) == {"numpy"}
    assert {"numpy", "pytest", "pluggy"} <= set(environments.needed(asked, ["dev"]))
    for wanted in ("no-such-distribution-at-all", "numpy>=999"):
        with pytest.raises(LookupError, match=re.escape(wanted)):
            environments.needed([wanted])
