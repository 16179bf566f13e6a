"""The paper's Table 1, reproduced: a resumable run over objects, queries and methods, and what is written of it.

``columns`` says what the table is, ``run`` measures, ``folder`` keeps what is measured, ``markdown`` and ``rank_plot`` show it.
Importing this package imports neither torch nor matplotlib.
"""

from warp_bounding.tables.columns import select_columns, select_methods
from warp_bounding.tables.folder import Folder, open_folder
from warp_bounding.tables.means import Means
from warp_bounding.tables.outputs import write_outputs, write_page
from warp_bounding.tables.plan import Job, TimeLeft, plan
from warp_bounding.tables.rows import PROTOCOLS, Row
from warp_bounding.tables.run import Outcome, run
from warp_bounding.tables.shapes import find_shapes, load_shapes, select_shapes
from warp_bounding.tables.tools import Tools

__all__ = [
    "PROTOCOLS",
    "Folder",
    "Job",
    "Means",
    "Outcome",
    "Row",
    "TimeLeft",
    "Tools",
    "find_shapes",
    "load_shapes",
    "open_folder",
    "plan",
    "run",
    "select_columns",
    "select_methods",
    "select_shapes",
    "write_outputs",
    "write_page",
]
