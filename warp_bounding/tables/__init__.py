"""The paper's Table 1, reproduced: a resumable run over objects, queries and methods, and what is written of it.

``columns`` says what the table is, ``run`` measures, ``folder`` keeps what is measured, ``markdown`` and ``rank_plot`` show it.
Importing this package imports neither torch nor matplotlib.
"""

from warp_bounding.tables.budgets import PRESETS, Preset, parse_budget
from warp_bounding.tables.columns import select_columns, select_methods
from warp_bounding.tables.folder import Folder, open_folder
from warp_bounding.tables.markdown import against_the_paper
from warp_bounding.tables.means import Means
from warp_bounding.tables.outputs import write_outputs, write_page
from warp_bounding.tables.plan import Job, Share, TimeLeft, duration, plan, preset_seconds, shares
from warp_bounding.tables.rows import PROTOCOLS, Row
from warp_bounding.tables.run import Outcome, run
from warp_bounding.tables.settings import Settings
from warp_bounding.tables.shapes import find_shapes, load_shapes, select_shapes
from warp_bounding.tables.tools import Tools

__all__ = [
    "PRESETS",
    "PROTOCOLS",
    "Folder",
    "Job",
    "Means",
    "Outcome",
    "Preset",
    "Row",
    "Settings",
    "Share",
    "TimeLeft",
    "Tools",
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
