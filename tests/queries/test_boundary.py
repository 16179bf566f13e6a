"""Points on a shape's border: in the object, near a point that is not, and where the object is cut off, on the end
itself."""

import numpy as np
import trimesh

import warp_bounding as wb
from warp_bounding.queries.boundary import ENDS_SHARE, border_points

COUNT = 4000
BALL = trimesh.creation.icosphere(subdivisions=2)


def motion() -> wb.shapes.MovingMesh:
    frames = [BALL.vertices, BALL.vertices * 1.2 + 0.3, BALL.vertices + np.array([0.5, 0.0, 0.0])]
    return wb.shapes.MovingMesh(np.array(frames), BALL.faces, times=[0.5, 1.0, 3.0])


def test_an_object_that_is_cut_off_has_points_on_its_ends(rng):
    shape, axis = motion(), 0
    x = border_points(shape, COUNT, rng)
    assert shape.contains(x).all()
    for end in (shape.lower[axis], shape.upper[axis]):
        on = x[x[:, axis] == end]
        assert 0.5 * ENDS_SHARE / 2 < len(on) / COUNT <= ENDS_SHARE / 2
        away = np.delete(on, axis, axis=1)
        beside = away + 1e-3 * (away - away.mean(axis=0))  # outwards, about
        assert (~shape.contains(np.insert(beside, axis, end, axis=1))).mean() > 0.5
