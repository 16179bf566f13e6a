"""The page of ``docs/_static/bunny.html``: ``python docs/site/seen.py``, what ``warp-bounding show --html`` writes.

The bunny in the proven network of the demo ``cloth``, 1.5 kB. The page holds no plotly.js, which would be fifteen times
its size: the site writes it into the folder of the page (``docs/conf.py``).
"""

import argparse
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))
LIBRARY = "plotly.min.js"


def main(path: Path) -> None:
    """Write the page."""
    from sims.cloth.scene import SPECS, dilated
    from sims.prefitted import bounders_of
    from warp_bounding.runtime.progress import quiet_warp
    from warp_bounding.views import page, view_of

    quiet_warp()
    shape = dilated("bunny")
    bounder = bounders_of("cloth-bunny", shape, {"mlp": SPECS["mlp"]}, device="cpu")["mlp"]
    view = view_of(bounder, shape, resolution=50)
    path.write_text(page(view, "The bunny in a proven network of 1.5 kB", "y", LIBRARY), encoding="utf-8")
    print(f"written to {path}, {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=ROOT / "docs/_static/bunny.html")
    main(parser.parse_args().out)
