"""The sdist and the wheel: how they are built, and what must be true of them.

``build`` makes both from a checkout. ``problems`` says in one line each what a user would stumble over: files that are
missing or do not belong there, folders of the machine that built them, a description that a package index cannot show.
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

__all__ = ["build", "contents", "metadata_of", "problems"]

LARGEST = 2_000_000  # bytes of a wheel
PACKAGE = "warp_bounding/"  # what a wheel installs
SUFFIXES = (".py", ".h", "/py.typed")  # of the files in it
SDIST = {"pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md", "CITATION.cff", "constraints.txt", "PKG-INFO"}
LINK = re.compile(r"""(?:href|src)=["']([^"']*)""")


def build(root: Path, out: Path, *, isolated: bool) -> tuple[Path, Path]:
    """Build the sdist of a checkout into a folder, and from the sdist the wheel.

    Args:
        root: The checkout.
        out: The folder.
        isolated: Whether the build's own requirements are installed into an environment of its own, as pip does it;
            else they must be installed beside this, and nothing is asked of the network.

    Returns:
        The wheel and the sdist.

    Raises:
        RuntimeError: If it fails, with what the build said.
    """
    out.mkdir(parents=True, exist_ok=True)
    options = [] if isolated else ["--no-isolation"]
    command = [sys.executable, "-m", "build", *options, "--outdir", str(out), str(root)]
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


def metadata_of(wheel: Path) -> Message:
    """The metadata of a wheel."""
    (text,) = (content.decode() for name, content in contents(wheel).items() if name.endswith(".dist-info/METADATA"))
    return message_from_string(text)


def problems(wheel: Path, sdist: Path, root: Path) -> list[str]:
    """What is wrong with a wheel and an sdist of a checkout, a line each; nothing if all is well."""
    files, source, metadata, size = contents(wheel), contents(sdist), metadata_of(wheel), wheel.stat().st_size
    found = [f"the wheel has {size:,} bytes, {LARGEST:,} at most"] if size > LARGEST else []
    parts = (path for path in (root / PACKAGE).rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    wanted = {path.relative_to(root).as_posix(): path for path in parts}
    found += [f"the wheel lacks {name}" for name in sorted({*wanted, f"{PACKAGE}py.typed"} - files.keys())]
    both = sorted(files.keys() & wanted.keys())
    found += [f"{name} is not the checkout's" for name in both if files[name] != wanted[name].read_bytes()]
    own = [name for name in files if ".dist-info/" not in name]
    strays = [name for name in own if name not in wanted or not name.endswith(SUFFIXES)]
    found += [f"{name} does not belong in the wheel" for name in sorted(strays)]
    found += [f"the sdist lacks {name}" for name in sorted(SDIST - source.keys())]
    machine = {str(root), str(Path.home())} - {"/"}
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=root, capture_output=True, text=True, check=False).stdout
    tracked = {name: (root / name).read_bytes() for name in listed.split("\0") if name and (root / name).is_file()}
    for where, held in ((wheel.name, files), (sdist.name, source), ("the checkout", tracked)):
        for name, content in held.items():
            named = folders(name, content)
            named += [folder for folder in machine if folder.encode() in content] if held is not tracked else []
            found += [f"{where}: {name} names a folder of a machine: {named[0]!r}"] if named else []
    if (root / "LICENSE").read_bytes() not in [content for name, content in files.items() if "/licenses/" in name]:
        found.append("the wheel lacks the licence")
    version = re.search(r'__version__ = "(.*)"', (root / f"{PACKAGE}version.py").read_text())[1]
    cited = re.search(r"^version: (.*)$", (root / "CITATION.cff").read_text(), re.MULTILINE)[1]
    if not metadata["Version"] == version == cited:
        found.append(f"versions differ: {metadata['Version']} (wheel), {version} (package), {cited} (CITATION.cff)")
    said = io.StringIO()
    html = markdown.render(metadata.get_payload(), stream=said) or ""  # as a package index shows it
    found += [] if html else [f"the description cannot be shown: {said.getvalue().strip()}"]
    places = {f"#{name}" for name in re.findall(r"""id=["']([^"']*)""", html)}
    links = [link for link in LINK.findall(html) if not link.startswith(("http://", "https://")) and link not in places]
    found += [f"the description leads to {link!r}, which a package index does not have" for link in links]
    command = [sys.executable, "-m", "twine", "check", "--strict", str(wheel), str(sdist)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return found + ([f"twine: {' '.join((done.stdout + done.stderr).split())}"] if done.returncode else [])
