"""Closed meshes by formulas: a bolt and a nut with threads, and hills."""

import numpy as np
import trimesh

import warp_bounding as wb


def joined(rings: list[np.ndarray], closed: bool) -> wb.shapes.Mesh:
    """Rings ``(S, 3)`` joined one to the next; the last to the first, or else both filled around their middles."""
    count, points, faces = len(rings[0]), np.concatenate(rings), []
    for a in range(len(rings) if closed else len(rings) - 1):
        one, other = a * count, (a + 1) % len(rings) * count
        for k in range(count):
            m = (k + 1) % count
            faces += [[one + k, one + m, other + m], [one + k, other + m, other + k]]
    if not closed:
        for end, turn in ((0, -1), (len(rings) - 1, 1)):
            points = np.concatenate([points, rings[end].mean(axis=0)[None]])
            faces += [[end * count + k, end * count + (k + 1) % count, len(points) - 1][::turn] for k in range(count)]
    return wb.shapes.Mesh(points.astype(np.float32), np.array(faces))


def bolt_and_nut(sides: int = 48, turns: int = 6) -> dict[str, wb.shapes.Mesh]:
    """A hexagonal bolt with a thread, 1 long, and a nut that fits it; centres of mass in the origin."""
    angle = np.arange(sides) * 2 * np.pi / sides
    pitch, shaft, wide, head = 0.72 / turns, 0.16, 0.3, 0.2

    def ring(radius, z: float) -> np.ndarray:
        return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(sides, z)], axis=1)

    def thread(z: float, more: float = 0.0):
        return shaft + more + 0.3 * pitch * np.abs(2 * ((z / pitch - angle / (2 * np.pi)) % 1) - 1)

    six = wide * np.cos(np.pi / 6) / np.cos((angle + np.pi / 6) % (np.pi / 3) - np.pi / 6)
    along = [ring(thread(z), z) for z in np.linspace(0, 0.72, 8 * turns + 1)]
    bolt = joined([*along, ring(six, 0.72 + 1e-3), ring(six, 0.72 + head)], closed=False)
    inside = [ring(thread(z, 0.02), z) for z in np.linspace(head, 0, 4 * turns)]
    nut = joined([*inside, ring(six, 0.0), ring(six, head)], closed=True)
    return {name: centred(mesh, name) for name, mesh in (("bolt", bolt), ("nut", nut))}


def centred(mesh: wb.shapes.Mesh, name: str) -> wb.shapes.Mesh:
    made = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    made.fix_normals()
    return wb.shapes.Mesh((made.vertices - made.center_mass).astype(np.float32), np.asarray(made.faces), name=name)


def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Height of the hills at x and y, metres: waves about a metre high, with small bumps."""
    rough = 0.03 * np.sin(5.1 * x + 2 * np.sin(1.7 * y)) * np.sin(4.3 * y + np.sin(2.9 * x))
    return 0.9 * np.sin(0.55 * x) * np.cos(0.45 * y + 0.3) + 0.3 * np.sin(1.3 * x + 0.8 * y) + rough


def hills(width: float, cells: int, tiles: int) -> list[wb.shapes.Mesh]:
    """A square of so many cells a side, cut into some tiles a side: closed meshes, down to below their lowest point."""
    edges, found = np.linspace(-width / 2, width / 2, tiles + 1), []
    for i, j in np.ndindex(tiles, tiles):
        axes = [np.linspace(edges[k], edges[k + 1], cells // tiles + 1) for k in (i, j)]
        x, y = np.meshgrid(*axes, indexing="ij")
        side, low = len(x), float(height(x, y).min()) - 0.3
        number = np.arange(side * side).reshape(side, side)
        a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
        faces = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
        around = np.concatenate([number[:-1, 0], number[-1, :-1], number[:0:-1, -1], number[0, :0:-1]])
        points = np.stack([x, y, height(x, y)], -1).reshape(-1, 3)
        under = points[around] * [1, 1, 0] + [0, 0, low]
        own, middle = len(points) + np.arange(len(around)), len(points) + len(around)
        after, below = np.roll(around, -1), np.roll(own, -1)
        skirt = [np.stack(part, -1) for part in ((around, own, below), (around, below, after))]
        faces = np.concatenate([faces, *skirt, np.stack([own, np.full(len(own), middle), below], -1)])
        points = np.concatenate([points, under, [[*under.mean(axis=0)[:2], low]]])
        found.append(wb.shapes.Mesh(points.astype(np.float32), faces, name=f"hills {i} {j}"))
    return found
