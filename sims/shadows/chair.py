"""A Windsor chair, generated: thin turned legs, stretchers and spindles, such as shadows are made of.

Every part is a closed tube: a path with a radius at each of its points, and a cap at either end. Parts run into each
other, as a joiner's do; their union is closed, since each of them is. All sizes are in units of the world, in which the
Stanford bunny is 1.6 high.

What this does not do: joints, mouldings, or a surface without faces inside others.
"""

import numpy as np

import warp_bounding as wb

__all__ = ["HEIGHT", "chair", "tube"]

HEIGHT = 1.72  # of the chair, from the floor
SEAT = 0.80  # height of the seat's upper side
SEAT_SIZE = (0.46, 0.42)  # half its width and its depth
LEG, SPINDLE, STRETCHER = 0.042, 0.016, 0.026  # largest radii
SPINDLES = 7
GRAIN = 2.0**14  # vertices lie on multiples of 1 / GRAIN, so that they are the same wherever sines are computed
TURNING = np.array(  # a turned leg: share of its length from the top, radius in shares of the largest
    [
        [0.0, 0.10, 0.30, 0.42, 0.45, 0.48, 0.53, 0.57, 0.66, 0.80, 1.0],
        [0.60, 0.72, 1.0, 0.78, 0.52, 0.95, 1.0, 0.55, 0.92, 0.70, 0.44],
    ]
).T


def tube(
    path: np.ndarray,
    radii: np.ndarray,
    *,
    sides: int = 14,
    section: tuple[float, float] = (1.0, 1.0),
    reference: tuple[float, float, float] = (0.0, 0.0, 1.0),
) -> tuple[np.ndarray, np.ndarray]:
    """A closed tube around a path, with elliptical rings.

    Args:
        path: ``(K, 3)``, K of at least 2.
        radii: ``(K,)``, all positive.
        sides: Corners of a ring.
        section: Factors of the radius along a ring's two axes; the second lies nearest to ``reference``.
        reference: A direction that the path is nowhere parallel to.

    Returns:
        Vertices ``(K * sides + 2, 3)`` and triangles ``(2 * K * sides, 3)``, which face outwards.
    """
    path, radii = np.asarray(path, dtype=np.float64), np.asarray(radii, dtype=np.float64)
    along = np.gradient(path, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along, reference)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    third = np.cross(across, along)
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = section[0] * np.cos(angle)[None, :, None] * across[:, None]
    ring = ring + section[1] * np.sin(angle)[None, :, None] * third[:, None]
    vertices = (path[:, None] + radii[:, None, None] * ring).reshape(-1, 3)
    rings, start, end = len(path), len(vertices), len(vertices) + 1
    i = np.arange(rings - 1)[:, None] * sides
    a, b = (i + np.arange(sides)).ravel(), (i + (np.arange(sides) + 1) % sides).ravel()
    c, d = a + sides, b + sides
    first, last = np.arange(sides), np.arange(sides) + (rings - 1) * sides
    faces = [
        np.stack([a, c, b], axis=1),
        np.stack([b, c, d], axis=1),
        np.stack([first, np.roll(first, -1), np.full(sides, start)], axis=1),
        np.stack([np.roll(last, -1), last, np.full(sides, end)], axis=1),
    ]
    return np.concatenate([vertices, path[[0, -1]]]), np.concatenate(faces)


def _rod(start, end, radius: float, sides: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """A straight rod that is a little thicker in its middle."""
    share = np.linspace(0.0, 1.0, 7)[:, None]
    path = np.asarray(start) * (1 - share) + np.asarray(end) * share
    return tube(path, radius * (0.72 + 0.28 * np.sin(np.pi * share[:, 0])), sides=sides, reference=_aside(start, end))


def _aside(start, end) -> tuple[float, float, float]:
    """The axis that a line is least parallel to."""
    return tuple(np.eye(3)[int(np.abs(np.subtract(end, start)).argmin())])


def _parts() -> list[tuple[np.ndarray, np.ndarray]]:
    """All parts of a chair that stands on y = 0 and faces +z."""
    w, d = SEAT_SIZE
    heights = SEAT + np.array([-0.075, -0.062, -0.02, 0.0])
    seat = tube(
        np.stack([np.zeros(4), heights, np.zeros(4)], axis=1),
        np.array([0.86, 0.95, 1.0, 0.96]),
        sides=40,
        section=(w, d),
        reference=(0.0, 0.0, 1.0),
    )
    parts, legs = [seat], {}
    for x in (-1, 1):
        for z in (-1, 1):
            top = np.array([0.58 * w * x, SEAT - 0.06, 0.58 * d * z])
            foot = np.array([0.95 * w * x, 0.0, 1.02 * d * z])
            legs[x, z] = lambda share, top=top, foot=foot: top * (1 - share) + foot * share
            share = TURNING[:, :1]
            parts.append(tube(top * (1 - share) + foot * share, LEG * TURNING[:, 1], reference=_aside(top, foot)))
    side = {x: (legs[x, -1](0.63), legs[x, 1](0.63)) for x in (-1, 1)}
    parts += [_rod(*ends, STRETCHER) for ends in side.values()]
    parts.append(_rod(sum(side[-1]) / 2, sum(side[1]) / 2, STRETCHER))
    parts.append(_rod(legs[-1, 1](0.46), legs[1, 1](0.46), 0.8 * STRETCHER))
    # the back: spindles fan out into a bent rail
    turn = np.linspace(-1.0, 1.0, 25)

    def rail(t: np.ndarray) -> np.ndarray:
        rise = HEIGHT - 0.055 - 0.05 * np.abs(t) ** 2
        return np.stack([1.04 * w * np.sin(t), rise, -0.62 * d - 0.62 * d * np.cos(t) + 0.12 * d], axis=-1)

    thick = np.sqrt(np.clip(1.0 - np.abs(turn) ** 6, 0.09, 1.0))
    parts.append(tube(rail(turn), 0.05 * thick, section=(0.42, 1.0), reference=(0.0, 1.0, 0.0)))
    for t in np.linspace(-0.86, 0.86, SPINDLES):
        foot = np.array([0.72 * w * np.sin(t), SEAT - 0.03, -0.62 * d * np.cos(t) - 0.1 * d])
        radius = SPINDLE * (1.35 if abs(t) > 0.8 else 1.0)
        parts.append(_rod(foot, rail(np.array(t)), radius))
    return parts


def chair(place: tuple[float, float, float] = (0.0, 0.0, 0.0), turn: float = 0.0) -> wb.shapes.Mesh:
    """The chair as a closed mesh.

    Args:
        place: Of the point on the floor below its seat, world units.
        turn: About the vertical, radians; at 0 it faces +z.
    """
    vertices, faces, count = [], [], 0
    for points, triangles in _parts():
        vertices.append(points)
        faces.append(triangles + count)
        count += len(points)
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    points = np.concatenate(vertices) @ rotation.T + place
    return wb.shapes.Mesh(np.rint(points * GRAIN) / GRAIN, np.concatenate(faces), name="chair")
