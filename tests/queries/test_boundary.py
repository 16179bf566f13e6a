"""Points on a shape's border: in the object, near a point that is not, and where the object is cut off, on the end
itself."""

import numpy as np
import pytest
import torch
import trimesh

import warp_bounding as wb
from warp_bounding.queries.boundary import ENDS_SHARE, border_points
from warp_bounding.queries.domain import Domain
from warp_bounding.training.samples import ShapePointSamples

COUNT = 4000
BALL = trimesh.creation.icosphere(subdivisions=2)


def motion() -> wb.shapes.MovingMesh:
    frames = [BALL.vertices, BALL.vertices * 1.2 + 0.3, BALL.vertices + np.array([0.5, 0.0, 0.0])]
    return wb.shapes.MovingMesh(np.array(frames), BALL.faces, times=[0.5, 1.0, 3.0])


def blend() -> wb.shapes.BlendShapes:
    return wb.shapes.BlendShapes(
        BALL.vertices, [BALL.vertices * [1.0, 0.0, 0.0]], BALL.faces, lower=[-0.3], upper=[0.7]
    )


@pytest.mark.parametrize(("made", "axis"), [(motion, 0), (blend, 3)])
def test_an_object_that_is_cut_off_has_points_on_its_ends(made, axis, rng):
    shape = made()
    x = border_points(shape, COUNT, rng)
    assert shape.contains(x).all()
    for end in (shape.lower[axis], shape.upper[axis]):
        on = x[x[:, axis] == end]
        assert 0.5 * ENDS_SHARE / 2 < len(on) / COUNT <= ENDS_SHARE / 2
        away = np.delete(on, axis, axis=1)
        beside = away + 1e-3 * (away - away.mean(axis=0))  # outwards, about
        assert (~shape.contains(np.insert(beside, axis, end, axis=1))).mean() > 0.5


def test_a_positive_walks_along_the_end_that_it_has_come_to(rng):
    shape = motion()
    domain = Domain.of(shape)
    samples = ShapePointSamples(shape, domain, torch.Generator().manual_seed(0))
    inside = np.array([[2.9, 0.5, 0.0, 0.0]])
    beyond = np.array([[3.4, 0.8, 0.1, 0.0]])
    assert shape.contains(inside).all()
    state = [torch.from_numpy(domain.to_local(x).astype(np.float32).T.copy()) for x in (inside, beyond)]
    resolved = domain.to_object(samples.resolved(*state).T.double().numpy())[0]
    assert np.abs(resolved - [3.0, 0.8, 0.1, 0.0]).max() < 1e-5
