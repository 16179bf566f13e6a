"""``python tools/release dist|check|resolve|lowest``: what a release is made of, and whether a stranger can use it.

``dist`` builds sdist and wheel into a folder and looks into them. ``check`` does so in a temporary one, installs the
wheel into clean environments and does in them what a stranger would; with ``--full`` pip fetches everything, else what
is installed here is linked. ``resolve`` asks which versions every supported Python would get. ``lowest`` installs the
lowest versions that are allowed and runs a part of the tests with them. Exit status 1 if something is wrong.
"""

import argparse
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests/shared"))

import strangers  # noqa: E402
from distributions import build, problems  # noqa: E402
from environments import installed, linked  # noqa: E402

EXTRAS = ((), strangers.CORE), (("sims",), strangers.DEMOS)


def dist(out: Path, *, isolated: bool) -> tuple[Path, list[str]]:
    """Build into a folder; the wheel, and what is wrong with it."""
    wheel, sdist = build(ROOT, out, isolated=isolated)
    for path in (wheel, sdist):
        print(f"{path}  {path.stat().st_size / 1e6:.2f} MB", flush=True)
    found = problems(wheel, sdist, ROOT)
    for line in found:
        print(line, file=sys.stderr)
    return wheel, found


def check(*, full: bool) -> int:
    """How many steps of a stranger's fail."""
    passed, failed = 0, 0
    with tempfile.TemporaryDirectory(prefix="warp-bounding-release-") as name:
        place = Path(name)
        wheel, found = dist(place / "dist", isolated=full)
        for extras, steps in EXTRAS:
            label, started = ", ".join(extras) or "core", time.perf_counter()
            where = place / f"env-{label}"
            environment = (
                installed(where, wheel, extras, ROOT / "constraints.txt") if full else linked(where, wheel, extras)
            )
            print(f"{label}: installed in {time.perf_counter() - started:.1f} s", flush=True)
            for step in steps:
                folder, started = place / f"{label}-{step.__name__}", time.perf_counter()
                folder.mkdir()
                try:
                    said = step(strangers.Stay(environment, folder, short=not full))
                    passed += 1
                except strangers.BrokenPromiseError as error:
                    said, failed = f"FAILED: {error}", failed + 1
                seconds = time.perf_counter() - started
                print(f"{label}: {step.__name__.replace('_', ' ')}: {said} ({seconds:.1f} s)", flush=True)
    print(f"{passed} passed, {failed} failed; {len(found)} problems with the distributions")
    return failed + len(found)


BOUNDS = {  # by its name, what ``uv pip compile`` is told
    "constraints.txt": ("--constraint", "constraints.txt"),
    "newest": (),
    "lowest": ("--resolution", "lowest-direct"),
}
SHOWN = ("warp-lang", "numpy", "scipy", "torch", "newton", "usd-core")


def resolve() -> int:
    """Print which versions every supported Python would get, in Markdown; 1 if some do not fit together."""
    print(f"| Python | versions | packages | {' | '.join(SHOWN)} |\n|---|---|---|{'---|' * len(SHOWN)}")
    named, failed = (
        re.findall(r'"Programming Language :: Python :: (3\.\d+)"', (ROOT / "pyproject.toml").read_text()),
        0,
    )
    for python, (name, options) in ((python, bound) for python in named for bound in BOUNDS.items()):
        command = [sys.executable, "-m", "uv", "pip", "compile", "--quiet", "--no-header", "--no-annotate"]
        command += ["--all-extras", "--python-version", python, *options, "pyproject.toml"]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        found = dict(re.findall(r"^([\w.-]+)==(\S+)", done.stdout, re.MULTILINE))
        versions = " | ".join(found.get(package, "") for package in SHOWN)
        print(f"| {python} | {name} | {'none' if done.returncode else len(found)} | {versions} |", flush=True)
        print(end=done.stderr, file=sys.stderr)
        failed += bool(done.returncode)
    return bool(failed)


TOOLS = ("pytest", "pytest-xdist", "hypothesis")
TESTS = (
    *("test_package.py", "test_extending.py", "bounders/test_files.py", "bounders/test_points.py"),
    *(
        "cli/test_commands.py",
        "cli/test_usage.py",
        "evaluation",
        "shapes/test_formats.py",
        "kernels/test_functions.py",
    ),
    *("newton", "proof/test_check.py", "sims/test_prefitted.py", "training/test_fit.py"),
)


def lowest() -> int:
    """Install the versions of ``constraints-min.txt`` and run a part of the tests; their exit status."""
    tests = [str(path) for test in TESTS if (path := ROOT / "tests" / test).exists()]
    with tempfile.TemporaryDirectory(prefix="warp-bounding-lowest-") as name:
        place = Path(
            name
        )  # the folder of the checkout is no place to stand in: it would be imported in place of the wheel
        wheel, _ = build(ROOT, place / "dist", isolated=True)
        environment = installed(place / "env", wheel, ("sims", "digits"), ROOT / "constraints-min.txt", TOOLS)
        options = ["-m", "pytest", "-p", "no:cacheprovider", "--rootdir", str(ROOT), "-c", str(ROOT / "pyproject.toml")]
        return environment.call(["python", *options, *tests], place)


def main() -> int:
    """Do the task that is requested; exit status."""
    parser = argparse.ArgumentParser(prog="tools/release", description=__doc__)
    tasks = parser.add_subparsers(required=True)
    task = tasks.add_parser("dist", help="build sdist and wheel, and look into them")
    task.add_argument("--out", type=Path, default=ROOT / "dist", help="folder for them")
    task.set_defaults(does=lambda asked: bool(dist(asked.out, isolated=True)[1]))
    task = tasks.add_parser("check", help="use the wheel as a stranger would")
    task.add_argument("--full", action="store_true", help="install everything with pip, and shorten nothing")
    task.set_defaults(does=lambda asked: bool(check(full=asked.full)))
    task = tasks.add_parser("resolve", help="which versions every supported Python would get")
    task.set_defaults(does=lambda _: resolve())
    task = tasks.add_parser("lowest", help="test the lowest versions that are allowed")
    task.set_defaults(does=lambda _: lowest())
    asked = parser.parse_args()
    try:
        return int(asked.does(asked))
    except (LookupError, RuntimeError) as error:
        print(error, file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
