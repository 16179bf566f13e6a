"""Builds the site: ``python docs/site [--out build/docs]``.

What pages say of ``results`` must be what is there (``measured.py``). Sources are laid out in ``<out>-sources``,
Sphinx makes pages of them (its warnings are errors), and every link of the pages is followed, without the web.
"""

import argparse
import sys
import time
from pathlib import Path

from links import problems
from measured import changed
from sphinx.cmd.build import build_main
from stage import ROOT, StageError, stage

__all__ = ["main"]


def main(arguments: list[str] | None = None) -> int:
    """Build the site; 0 if it is whole, 1 if something in it is not, 2 for bad usage."""
    parser = argparse.ArgumentParser(prog="python docs/site", description="Build the documentation site.")
    parser.add_argument("--out", type=Path, default=ROOT / "build/docs", help="where the pages go")
    out = parser.parse_args(arguments).out.resolve()
    sources, start = out.with_name(f"{out.name}-sources"), time.perf_counter()
    if stale := [page.relative_to(ROOT).as_posix() for page in changed()]:
        print(
            f"error: {', '.join(stale)}: differs from results/; python docs/site/measured.py writes it", file=sys.stderr
        )
        return 1
    try:
        stage(sources)
    except StageError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    options = ["--fresh-env", "--fail-on-warning", "--keep-going", "--quiet", "--jobs", "auto"]
    doctrees = str(out.with_name(f"{out.name}-doctrees"))
    if build_main(["-b", "html", "-c", str(ROOT / "docs"), "-d", doctrees, *options, str(sources), str(out)]):
        return 1
    found = problems(out)
    for line in found:
        print(f"error: {line}", file=sys.stderr)
    if not found:
        print(f"{len(list(out.rglob('*.html')))} pages in {time.perf_counter() - start:.0f} s: {out / 'index.html'}")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
