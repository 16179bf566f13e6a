"""Pictures of a bound: level sets of its answers around the object, queried points, and how they are shown.

``view_of`` computes what is seen, with nothing but the bounder's own answers and the shape's own truth. ``draw.page``
writes it as one self-contained web page. Importing this package needs neither pyvista nor plotly.
"""

from warp_bounding.views.view import State, View, view_of

__all__ = ["State", "View", "view_of"]
