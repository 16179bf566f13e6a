"""The sdist and the wheel: how they are built, and what must be true of them.

``build`` makes both from a checkout. ``problems`` looks into them and says in one line each what a user would stumble over: files that are missing or do not
belong there, folders of the machine that built them, a description that a package index cannot show.
"""

import io
import re
import subprocess
import sys
import tarfile
import zipfile
from email import message_from_string
from email.message import Message
from pathlib import Path

from named_folders import folders
from readme_renderer import markdown

__all__ = ["LARGEST", "build", "contents", "described", "metadata_of", "problems", "told_by_twine"]

LARGEST = 2_000_000  # bytes of a wheel
PARTS = ("warp_bounding/",)  # what a wheel installs
SUFFIXES = (
    ".py",
    ".h",
    "/py.typed",
    "/templates/page.css",
    "/templates/page.html",
    "/templates/page.js",
)  # of the files in them
LINK = re.compile(r"""(?:href|src)=["']([^"']*)""")


def build(root: Path, out: Path, *, isolated: bool) -> tuple[Path, Path]:
    """Build the sdist, and the wheel from the sdist, not from the checkout.

    Args:
        root: The checkout.
        out: A folder; what it holds of older builds stays.
        isolated: Whether the build's own requirements are installed into an environment of its own, as pip does it; else they must be
            installed beside this, and nothing is asked of the network.

    Returns:
        The wheel and the sdist.

    Raises:
        RuntimeError: If it fails, with what the build said.
    """
    out.mkdir(parents=True, exist_ok=True)
    command = [
        sys.executable,
        "-m",
        "build",
        *([] if isolated else ["--no-isolation"]),
        "--outdir",
        str(out),
        str(root),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    made = re.search(r"Successfully built (\S+\.tar\.gz) and (\S+\.whl)", done.stdout)
    if done.returncode or not made:
        raise RuntimeError(f"building failed:\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
    sdist, wheel = (out / name for name in made.groups())
    return wheel, sdist


def contents(path: Path) -> dict[str, bytes]:
    """The files of a wheel or an sdist by their names, those of an sdist without the folder around them."""
    if path.suffix == ".whl":
        with zipfile.ZipFile(path) as archive:
            return {name: archive.read(name) for name in archive.namelist()}
    with tarfile.open(path) as archive:
        files = [member for member in archive.getmembers() if member.isfile()]
        return {file.name.partition("/")[2]: archive.extractfile(file).read() for file in files}


def metadata_of(files: dict[str, bytes]) -> Message:
    """The metadata of a wheel."""
    (text,) = (content.decode() for name, content in files.items() if name.endswith(".dist-info/METADATA"))
    return message_from_string(text)


def described(text: str) -> str:
    """Markdown as the HTML that a package index shows.

    Raises:
        ValueError: If it cannot be shown.
    """
    said = io.StringIO()
    if (html := markdown.render(text, stream=said)) is None:
        raise ValueError(said.getvalue().strip() or "no Markdown renderer is installed")
    return html


def problems(wheel: Path, sdist: Path, root: Path) -> list[str]:
    """What is wrong with a wheel and an sdist of a checkout, a line each; nothing if all is well."""
    files, source = contents(wheel), contents(sdist)
    found = (
        []
        if wheel.stat().st_size <= LARGEST
        else [f"the wheel has {wheel.stat().st_size:,} bytes, {LARGEST:,} at most"]
    )
    found += _of_names(files, root) + _of_metadata(files, root)
    needed = {"pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md", "CITATION.cff", "constraints.txt", "PKG-INFO"}
    found += [f"the sdist lacks {name}" for name in sorted(needed - source.keys())]
    for archive, held in ((wheel, files), (sdist, source)):
        own = {str(root), str(Path.home())} - {"/"}
        for name, content in held.items():
            named = folders(name, content) + [folder for folder in own if folder.encode() in content]
            found += [f"{archive.name}: {name} names a folder of a machine: {named[0]!r}"] if named else []
    return found


def told_by_twine(*paths: Path) -> list[str]:
    """What the program that uploads distributions has against them."""
    command = [sys.executable, "-m", "twine", "check", "--strict", *map(str, paths)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return [f"twine: {' '.join((done.stdout + done.stderr).split())}"] if done.returncode else []


def _of_names(files: dict[str, bytes], root: Path) -> list[str]:
    """Files that a wheel lacks, or that do not belong in it."""
    parts = [
        path for top in PARTS for path in (root / top).rglob("*") if path.is_file() and "__pycache__" not in path.parts
    ]
    wanted = {path.relative_to(root).as_posix(): path for path in parts}
    own = {name for name in files if name.startswith(PARTS)}
    found = [f"the wheel lacks {name}" for name in sorted(wanted.keys() - own)]
    found += [f"the wheel's {name} is not the checkout's" for name in sorted(own & wanted.keys()) if files[name] != wanted[name].read_bytes()]  # fmt: skip
    found += [f"the wheel lacks {name}" for name in ("warp_bounding/py.typed",) if name not in own]
    strays = [name for name in files if ".dist-info/" not in name and name not in wanted]
    strays += [name for name in own if not name.endswith(SUFFIXES) or "test" in Path(name).parts[-1]]
    return found + [f"{name} does not belong in the wheel" for name in sorted(set(strays))]


def _of_metadata(files: dict[str, bytes], root: Path) -> list[str]:
    """What is wrong with the description of a wheel."""
    metadata, found = metadata_of(files), []
    licence = (root / "LICENSE").read_bytes()
    if licence not in [content for name, content in files.items() if "/licenses/" in name]:
        found.append("the wheel lacks the licence")
    version = re.search(r'__version__ = "(.*)"', (root / "warp_bounding/version.py").read_text())[1]
    cited = re.search(r"^version: (.*)$", (root / "CITATION.cff").read_text(), re.MULTILINE)[1]
    if not metadata["Version"] == version == cited:
        found.append(
            f"versions differ: {metadata['Version']} (wheel), {version} (warp_bounding), {cited} (CITATION.cff)"
        )
    text = metadata.get_payload()
    html = described(text)
    places = {f"#{name}" for name in re.findall(r"""id=["']([^"']*)""", html)}
    links = [link for link in LINK.findall(html) if not link.startswith(("http://", "https://")) and link not in places]
    found += [f"the description leads to {link!r}, which a package index does not have" for link in links]
    blocks = [re.findall(r"```.*?```", page, re.DOTALL) for page in (text, (root / "README.md").read_text())]
    if blocks[0] != blocks[1]:
        found.append("the code in the description is not the README's")
    return found
