"""The pages in reading order: the README, *Get started*, the guide page by page, and what they lead to."""

import re
from pathlib import Path

__all__ = ["GUIDE", "PAGES", "ROOT"]

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
GUIDE = [
    DOCS / target
    for target in re.findall(r"^\* \[.*?\]\((guide/[\w-]+\.md)\)", (DOCS / "guide.md").read_text(), re.MULTILINE)
]
PAGES = [ROOT / "README.md", DOCS / "get-started.md", DOCS / "guide.md", *GUIDE]
PAGES += [DOCS / f"{name}.md" for name in ("is-it-for-me", "which-bounder", "simulations", "paper", "claims")]
