"""Pictures of a bound: level sets of its answers around the object, queried points, and how they are shown.

``view_of`` computes what is seen, with nothing but the bounder's own answers and the shape's own truth. ``draw.page``
writes it as one self-contained web page. Importing this package needs neither pyvista nor plotly.
"""

from warp_bounding.views.draw import Drawn, draw_with, with_palette
from warp_bounding.views.view import State, View, view_of

__all__ = ["Drawn", "State", "View", "draw_with", "view_of", "with_palette"]
