"""The paper's Table 1, reproduced, and what a proof is worth: resumable runs over objects, queries and methods, and what is written of them.

``columns`` says what the table is, ``run`` and ``proofs`` measure, ``folder`` keeps what is measured (``rows``), ``pages`` show it.
Importing this package imports neither torch nor matplotlib.
"""

from warp_bounding.paper.budgets import PRESETS, parse_budget
from warp_bounding.paper.columns import select_columns, select_methods
from warp_bounding.paper.folder import open_folder
from warp_bounding.paper.pages.markdown import against_the_paper, write_outputs, write_page
from warp_bounding.paper.pages.means import Means
from warp_bounding.paper.plan import duration, plan, preset_seconds, shares
from warp_bounding.paper.rows import PROOFS, PROTOCOLS, TABLE1, Row
from warp_bounding.paper.run import Outcome, run
from warp_bounding.paper.settings import Settings
from warp_bounding.paper.shapes import find_shapes, load_shapes, select_shapes

__all__ = [
    "PRESETS",
    "PROOFS",
    "PROTOCOLS",
    "TABLE1",
    "Means",
    "Outcome",
    "Row",
    "Settings",
    "against_the_paper",
    "duration",
    "find_shapes",
    "load_shapes",
    "open_folder",
    "parse_budget",
    "plan",
    "preset_seconds",
    "run",
    "select_columns",
    "select_methods",
    "select_shapes",
    "shares",
    "write_outputs",
    "write_page",
]
