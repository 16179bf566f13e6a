"""What a stranger does with a wheel: in an environment without extras, and in one with those of the demos.

Each step is a function of an environment and an empty folder to stand in; it raises ``BrokenPromiseError`` with what it
expected and what came. Nothing is imported here of the package that is looked at: it is asked as a user would, by
commands and by scripts.
"""

import re
import shutil
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from subprocess import CompletedProcess

from environments import Environment
from snippets import FENCED, commands

__all__ = ["CORE", "DEMOS", "BrokenPromiseError", "Stay"]

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
FIT = "budget=60.0"  # of the README's quickstart
SHORT_FIT = "budget=3.0, steps=20"
SHORT_CHOICE = ("--methods", "aabb,obb,kdop", "--budget", "2")
MINUTE = 60.0  # seconds
HELP = """
import sys
from warp_bounding import cli
sys.argv, names = ["warp-bounding"], sys.argv[1:]
for name in names:
    print(end="\f")
    try:
        cli.main([name, "--help"])
    except SystemExit as stop:
        if stop.code:
            raise
"""
PROMISED = """
assert mask.numpy().sum() > 0
assert (contacts.numpy() == mask.numpy()).all()
print("what the comments promise is so")
"""


class BrokenPromiseError(Exception):
    """Something does not work that a user was promised."""


@dataclass(frozen=True)
class Stay:
    """A stranger's stay.

    Attributes:
        environment: Where the wheel is installed.
        folder: Where the stranger stands, outside of any checkout.
        short: Whether fits are shortened to seconds.
    """

    environment: Environment
    folder: Path
    short: bool

    def run(self, words: Iterable[object], *, status: int = 0, seconds: float = 5 * MINUTE) -> CompletedProcess:
        """Run a command, which must end with a status and without a traceback.

        Raises:
            BrokenPromiseError: If it does not.
        """
        words = [str(word) for word in words]
        done = self.environment.run(words, self.folder, seconds=seconds)
        if done.returncode != status or "Traceback" in done.stderr:
            said = (done.stdout + done.stderr)[-2000:]
            raise BrokenPromiseError(f"{' '.join(words)}: expected exit status {status}, got {done.returncode}\n{said}")
        return done


def _with_demos(stay: Stay) -> None:
    """The demos, which only a clone has; what they import of the package is the wheel's."""
    shutil.copytree(ROOT / "sims", stay.folder / "sims", dirs_exist_ok=True)


def _expect(holds: object, what: str) -> None:
    if not holds:
        raise BrokenPromiseError(what)


def installed_outside(stay: Stay) -> str:
    """What is imported is what was installed, and its version is the command's."""
    code = "import warp_bounding as wb; print(wb.__file__); print(wb.__version__)"
    *files, version = stay.run(["python", "-c", code]).stdout.split()
    places = [Path(file).resolve() for file in files]
    _expect(all(place.is_relative_to(stay.environment.folder.resolve()) for place in places), f"imported from {places}")
    said = stay.run(["warp-bounding", "--version"]).stdout.strip()
    _expect(said == f"warp-bounding {version}", f"--version: expected {version}, got {said!r}")
    return version


def every_help(stay: Stay) -> str:
    """``--help`` of the program and, in one process, of each of its commands."""
    overview = stay.run(["warp-bounding", "--help"]).stdout
    names = re.findall(r"^│ ([a-z]\w*) ", overview.partition("Commands")[2], re.MULTILINE)
    _expect({"fit", "certify", "choose"} <= set(names), f"--help lists {names}")
    pages = stay.run(["python", "-c", HELP, *names]).stdout.split("\f")[1:]
    for name, page in zip(names, pages, strict=True):
        _expect(f"Usage: warp-bounding {name}" in page and "--json" in page, f"{name} --help: {page[:300]}")
    return f"{len(names)} commands"


def core_alone(stay: Stay) -> str:
    """Load and ask without any extra: ``without_extras.py``."""
    shutil.copy(HERE / "without_extras.py", stay.folder)
    shutil.copytree(ROOT / "sims/bounders", stay.folder / "bounders", dirs_exist_ok=True)
    return stay.run(["python", "without_extras.py"]).stdout.splitlines()[-1]


def extras_are_named(stay: Stay) -> str:
    """What needs an extra says in one line which one."""
    (stay.folder / "ball.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    queried = {"train": ["fit", "ball.obj", "-o", "ball.safetensors", "--method", "mlp"]}
    for extra, words in queried.items():
        said = stay.run(["warp-bounding", *words], status=2).stderr.strip().splitlines()
        _expect(
            len(said) == 1 and f"pip install 'warp-bounding[{extra}]'" in said[0],
            f"{words[0]} without {extra} says {said}",
        )
    return ", ".join(queried)


def quickstart(stay: Stay) -> str:
    """Commands before the README's first snippet, all snippets, then the other commands, in one folder."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    _with_demos(stay)
    _expect(FIT in text, f"the README's quickstart has no {FIT} that could be shortened")
    text, snippets, before, behind = text.replace(FIT, SHORT_FIT) if stay.short else text, [], [], []
    for language, body in FENCED.findall(text):
        if language == "python":
            snippets.append(body)
            continue
        reported = commands(body)  # the others set up a checkout
        ours = [words for words in reported if words[0] == "warp-bounding" or words[1:3] == ["-m", "sims"]]
        (behind if snippets else before).extend(ours)
    for words in before:
        stay.run(words)
    (stay.folder / "quickstart.py").write_text("\n".join([*snippets, PROMISED]), encoding="utf-8")  # one namespace
    said = stay.run(["python", "quickstart.py"]).stdout.strip().splitlines()
    stay.run(["warp-bounding", "info", "bunny.safetensors"], status=0 if "proven" in said else 1)
    for words in behind:
        stay.run([*words, *SHORT_CHOICE] if stay.short and words[1] == "choose" else words)
    return f"{len(snippets)} snippets, {len(before) + len(behind)} commands"


def particles(stay: Stay) -> str:
    """The first demo, small: every run ends in the same state, and there are pictures."""
    _with_demos(stay)
    few = ["--particles", "2000", "--steps", "6"] if stay.short else []
    stay.run(["python", "-m", "sims", "particles", "--quick", *few, "--output", "demo"])
    pictures = sorted(path.name for path in (stay.folder / "demo").rglob("*.png"))
    _expect(pictures, "the demo wrote no picture")
    return f"{len(pictures)} pictures"


Step = Callable[[Stay], str]
CORE: tuple[Step, ...] = (installed_outside, every_help, core_alone, extras_are_named)
DEMOS: tuple[Step, ...] = (installed_outside, quickstart, particles)
