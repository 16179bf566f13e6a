"""The paper's figures, one file each, by the protocol of ``drawing/base.py``.

**How to add one.** A file here with a subclass of ``Figure``, and a line in ``FIGURES`` below; everything else (resumption,
settings, refusals, the page, ``all``, its share of the tests) follows. The class states ``name``, ``title``, ``caption``, ``paper``
(where the paper shows it) and ``objects``: of the paper's data, each with one of our own (``drawing/shapes.py``) where that can stand in;
none if it draws its own. ``parts(work)`` returns functions by name, each of some seconds to minutes, that return JSON: whatever one
returns is kept at once and not computed again. ``work`` fits (``work.fit``, whose seconds the folder's settings scale), measures
(``work.rates``), reads objects (``work.shape``) and picks between the full and the quick form (``work.choose``). ``draw(parts, tools)`` makes
PNG and SVG of that JSON alone, with panels of matplotlib (``drawing/canvas.py``), rasters (``drawing/masks.py``) and scenes in
3D (``drawing/pictures.py``, ``drawing/solids.py``); ``facts(parts)`` are the measured sentences under the picture.
"""

from paper.drawing.base import Figure
from paper.figures.applications import Applications
from paper.figures.complexity import Complexity
from paper.figures.convergence import Convergence
from paper.figures.digits import Digits
from paper.figures.distances import Distances
from paper.figures.gallery import Gallery
from paper.figures.hierarchy import Hierarchy
from paper.figures.kdop import Kdop
from paper.figures.objects import Objects
from paper.figures.progressive import Progressive
from paper.figures.relu_fields import ReluFields
from paper.figures.sides import Sides
from paper.figures.teaser import Teaser

__all__ = ["FIGURES"]

FIGURES: tuple[Figure, ...] = (
    Teaser(),
    Progressive(),
    Gallery(),
    Objects(),
    Kdop(),
    ReluFields(),
    Convergence(),
    Complexity(),
    Hierarchy(),
    Sides(),
    Distances(),
    Digits(),
    Applications(),
)
