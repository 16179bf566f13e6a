"""Balls that hold a mesh: found, proven, arranged as a tree, and kept in a file.

*Which balls.* The largest ball within the solid that touches the surface at a point, from inside, stands out of the
solid nowhere (a medial ball, by shrinking balls: Ma, Bae and Choi 2012). Enlarged by e, some of them hold everything
while none stands out by more than e. For a given number of balls the least e is searched for; for each e balls are
chosen greedily, the one first that holds most of the sample points that no other holds yet. Then every point goes to
the ball that must grow least for it, and balls shrink to their points.

*The proof* (``search_mesh``) halves the box around the mesh until each box lies in one ball, or the mesh certifies that
it is empty. A box lies in a ball if its farthest corner does, in float64 with a bound of its rounding. ``of`` lets
balls grow until that is so; ``certify`` proves it from the balls and the mesh alone.

*The tree* (``Tree``) follows from the balls: halves along the longest side of their centres, eight parts a node. A
node's ball is the smallest found that holds its children's balls, its radius rounded up.
"""

import heapq
import os
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
import warp as wp
from scipy.spatial import cKDTree

from warp_bounding import shapes
from warp_bounding.bounders.file_format import read, write
from warp_bounding.bounders.load import BALLS
from warp_bounding.certificates import Certificate
from warp_bounding.errors import BounderError, FileFormatError, ShapeError
from warp_bounding.pairs.kernels import GROUP
from warp_bounding.proof.halving import Boxes, Seen, search
from warp_bounding.rounding import round_up
from warp_bounding.runtime.launch import device_of, working_seconds
from warp_bounding.runtime.whole_file import file_path
from warp_bounding.shapes.mesh import Mesh
from warp_bounding.shapes.shape import IN

MOST = 2**15  # balls: ``kernels.STACK`` is enough for the groups of a tree
INWARDS = 1 - 2.0**-40  # outweighs what float64 rounds in a squared length
NEAREST = 8  # balls that are looked at for each box
BOX_BATCH = 1 << 16  # boxes that are halved at a time
FINEST = 2.0**-11  # of the longest side: boxes that small are not halved by ``of``
LEAST_SIDE = 2.0**-14  # of the longest side: ``certify`` ends at boxes that small
POINTS, CANDIDATES, FEWEST = 40, 10, 5000  # points on the surface and candidates, for each ball; points at least


class _Search(NamedTuple):
    """Of halving boxes: how many, whether none was left, and a point of the mesh in no ball, if one was met."""

    boxes: int
    complete: bool
    bare: np.ndarray | None


def _lifted(centers: np.ndarray, radii: np.ndarray) -> cKDTree:
    """A tree in four dimensions whose nearest entry to ``(x, 0)`` has the least ``|x - c|^2 - r^2``."""
    height = np.sqrt(np.maximum(radii.max() ** 2 - radii**2, 0.0))
    return cKDTree(np.column_stack([centers, height]))


def _reach(centers: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """The distance of the farthest corner of boxes from centres; both broadcast, ``(..., 3)``."""
    far = np.maximum(np.abs(centers - lower), np.abs(upper - centers))
    return np.sqrt((far * far).sum(axis=-1)) / INWARDS


def search_mesh(
    mesh: Mesh, centers: np.ndarray, radii: np.ndarray, least: float, end: float = np.inf, grow: bool = False
) -> _Search:
    """Halve the box around a mesh until boxes lie in a ball or are empty, or one of side ``least`` is left.

    With ``grow``, the ball that needs least for such a box grows in place; else the middles of boxes that are left are
    looked at, and the search ends at the first one of the mesh that no ball holds.
    """
    look = _Balls(mesh, centers, radii, least, grow)
    if not grow and (bare := _bare(mesh, look.tree, centers, radii, mesh.corners())) is not None:
        return _Search(0, False, bare)
    start = (mesh.lower.astype(np.float64)[None], mesh.upper.astype(np.float64)[None], 1.0)
    left = search(look, [start], np.empty(0), budget=end - working_seconds())
    bare = left.failed[0] if left.failed else ()
    return _Search(left.boxes, left.complete, bare[0] if len(bare) else None)


class _Balls:
    """Looks at boxes; arguments as in ``search_mesh``."""

    chunk = BOX_BATCH

    def __init__(self, mesh: Mesh, centers: np.ndarray, radii: np.ndarray, least: float, grow: bool):
        self.mesh, self.centers, self.radii, self.least, self.grow = mesh, centers, radii, least, grow
        self.tree = _lifted(centers, radii)

    def __call__(self, boxes: Boxes) -> Seen:
        mesh, centers, radii, (lower, upper, *_) = self.mesh, self.centers, self.radii, boxes
        middle = lower / 2 + upper / 2
        near = self.tree.query(np.column_stack([middle, np.zeros(len(middle))]), k=min(NEAREST, len(radii)))[1]
        near = near.reshape(len(middle), -1)
        missing = _reach(centers[near], lower[:, None], upper[:, None]) - radii[near]
        left = np.flatnonzero(~(missing.min(axis=1) <= 0))
        left = left[~mesh.empty(lower[left], upper[left])]
        small = (upper[left] - lower[left]).max(axis=1) <= self.least
        failed = None
        if self.grow and small.any():
            rest = left[small]
            best = near[rest, missing[rest].argmin(axis=1)]
            np.maximum.at(radii, best, _reach(centers[best], lower[rest], upper[rest]))
            self.tree = _lifted(centers, radii)
        elif not self.grow:
            bare = _bare(mesh, self.tree, centers, radii, middle[left])
            if bare is not None or small.any():
                failed = np.empty((0, 3)) if bare is None else bare[None], np.empty(0, np.int64)
        rest, none = boxes.part(left[~small]), np.empty(0, np.int64)
        return Seen(rest.halves((rest.upper - rest.lower).argmax(axis=1)), none, none.astype(float), failed)


def _bare(mesh: Mesh, tree: cKDTree, centers: np.ndarray, radii: np.ndarray, points: np.ndarray) -> np.ndarray | None:
    """One of these points that is certainly of the mesh and in no ball."""
    nearest = tree.query(np.column_stack([points, np.zeros(len(points))]))[1] if len(points) else np.empty(0, int)
    out = points[((points - centers[nearest]) ** 2).sum(axis=1) * INWARDS > radii[nearest] ** 2]
    out = out[mesh.decide(out) == IN] if len(out) else out
    for x in out[:100]:  # the tree's nearest is rounded, and beside a huge ball another one
        if (((x - centers) ** 2).sum(axis=1) * INWARDS > radii**2).all():
            return x
    return None


def medial(points: np.ndarray, normals: np.ndarray, others: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Balls ``(N, 3)``, ``(N,)`` that touch points from inside and hold none of the others; by shrinking."""
    tree, radii = cKDTree(others), np.full(len(points), size)
    for _ in range(40):
        centers = points - normals * radii[:, None]
        distance, nearest = tree.query(centers)
        apart = points - others[nearest]
        depth = (apart * normals).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            smaller = (apart * apart).sum(axis=1) / (2 * depth)
        shrinks = (distance < radii * (1 - 1e-4)) & (depth > 0) & (smaller < radii * (1 - 1e-4))
        if not shrinks.any():
            break
        radii = np.where(shrinks, smaller, radii)
    return points - normals * radii[:, None], radii


class _Candidates:
    """Balls to choose from, and by how much each must grow for the points that it may come to hold."""

    def __init__(self, points: np.ndarray, most: float):
        self.points, self.most = points, most
        self.centers, self.radii = np.empty((0, 3)), np.empty(0)
        self.held: list[np.ndarray] = []  # points, in ascending order of ``away``
        self.away: list[np.ndarray] = []
        self.least = np.full(len(points), np.inf)  # of each point, over all candidates

    def add(self, centers: np.ndarray, radii: np.ndarray) -> None:
        """Take more, their centres rounded to float32."""
        centers = centers.astype(np.float32).astype(np.float64)
        tree = cKDTree(self.points)
        for center, own, near in zip(centers, radii, tree.query_ball_point(centers, radii + self.most), strict=True):
            near = np.array(near, dtype=np.int32)
            far = np.sqrt(((self.points[near] - center) ** 2).sum(axis=1)) - own
            order = far.argsort(kind="stable")
            self.held.append(near[order])
            self.away.append(far[order])
            np.minimum.at(self.least, near, far)
        self.centers, self.radii = np.concatenate([self.centers, centers]), np.concatenate([self.radii, radii])

    def chosen(self, by: float, count: int) -> list[int] | None:
        """Which, at most so many, hold all points if enlarged ``by``; ``None`` if more are needed.

        The next is the one that holds most points that no other holds yet.
        """
        if by < self.least.max():
            return None
        counts = [int(np.searchsorted(own, by, side="right")) for own in self.away]
        heap = [(-number, k) for k, number in enumerate(counts) if number]
        heapq.heapify(heap)
        missing, found, left = np.ones(len(self.points), dtype=bool), [], len(self.points)
        while left:
            _, k = heapq.heappop(heap)
            own = self.held[k][: counts[k]]
            new = int(missing[own].sum())
            if heap and new < -heap[0][0]:
                heapq.heappush(heap, (-new, k))
                continue
            if len(found) == count:
                return None
            found.append(k)
            missing[own] = False
            left -= new
        return found

    def fitted(self, chosen: list[int]) -> tuple[np.ndarray, np.ndarray]:
        """Centres and radii of these, each point held by the one that grows least for it."""
        least, owner = np.full(len(self.points), np.inf), np.zeros(len(self.points), dtype=np.int64)
        for number, k in enumerate(chosen):
            closer = self.away[k] < least[self.held[k]]
            own = self.held[k][closer]
            least[own], owner[own] = self.away[k][closer], number
        grown = np.full(len(chosen), -np.inf)
        np.maximum.at(grown, owner, least)
        radii = self.radii[chosen] + grown
        used = radii >= 0
        return self.centers[chosen][used], radii[used]


def _found(mesh: Mesh, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, float]:
    """Centres, radii and the search's e: balls that hold sample points of the mesh."""
    corners = mesh.vertices.astype(np.float64)[mesh.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.sqrt((across * across).sum(axis=1))
    size = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    number = max(POINTS * count, FEWEST)
    face = rng.choice(len(area), number, p=area / area.sum())
    weights = rng.dirichlet(np.ones(3), number)
    seeds, normals = (corners[face] * weights[:, :, None]).sum(axis=1), across[face] / area[face, None]
    points, centers, radii = [seeds, mesh.corners()], seeds, np.zeros(number)
    if mesh.watertight:
        sign = np.where(mesh.contains(seeds - 1e-4 * size * normals), 1.0, -1.0)[:, None]  # faces may be turned inwards
        centers, radii = medial(seeds, normals * sign, np.concatenate(points), size)
        outside = ~mesh.contains(centers)  # of thin parts, and where faces overlap
        centers[outside], radii[outside] = seeds[outside], 0.0
        inner = rng.uniform(mesh.lower, mesh.upper, (FEWEST, 3))
        points.append(inner[mesh.contains(inner)])
    own, high = np.arange(number) % (POINTS // CANDIDATES) == 0, 0.3 * size * count**-0.5
    while True:
        candidates = _Candidates(np.concatenate(points), high)
        candidates.add(centers[own], radii[own])
        candidates.add(seeds[own][::4], np.zeros(len(seeds[own][::4])))
        best = candidates.chosen(high, count)
        if best is not None:
            break
        high *= 2
    low = 0.0
    for more in (True, False):
        while high - low > 0.05 * high:
            middle = (low + high) / 2
            found = candidates.chosen(middle, count)
            low, high, best = (middle, high, best) if found is None else (low, middle, found)
        if more:  # where candidates stand too far apart, and again
            worst = candidates.least[:number].argsort(kind="stable")[-2 * count :]
            candidates.add(centers[worst], radii[worst])
            low = 0.5 * low
    return *candidates.fitted(best), high


class Tree(NamedTuple):
    """Balls in groups of eight, the root's children first.

    Attributes:
        slots: ``(G, 4, 8)`` float32: x, y, z and radius; radii of empty places are minus infinity.
        links: ``(G, 8)`` int32: the group of a ball's children; -1 for leaves and empty places.
    """

    slots: np.ndarray
    links: np.ndarray

    @classmethod
    def of(cls, centers: np.ndarray, radii: np.ndarray) -> "Tree":
        """The tree over balls ``(K, 3)``, ``(K,)`` float32; the same on every machine."""
        groups: list[list[tuple[np.ndarray, float, int]]] = []
        centers, radii = centers.astype(np.float64), radii.astype(np.float64)

        def group(own: np.ndarray) -> int:
            place = len(groups)
            groups.append([])
            for part in _parts(centers, own):
                if len(part) == 1:
                    groups[place].append((centers[part[0]], float(radii[part[0]]), -1))
                else:
                    child = group(part)
                    groups[place].append((*_around(groups[child]), child))
            return place

        group(np.arange(len(radii)))
        slots = np.zeros((len(groups), 4, GROUP), dtype=np.float32)
        slots[:, 3] = -np.inf
        links = np.full((len(groups), GROUP), -1, dtype=np.int32)
        for g, entries in enumerate(groups):
            for i, (center, radius, link) in enumerate(entries):
                slots[g, :, i] = *center, radius
                links[g, i] = link
        return cls(slots, links)


def _parts(centers: np.ndarray, own: np.ndarray) -> list[np.ndarray]:
    """Balls in at most eight parts of about one size, single ones where there are no more than eight."""
    count = len(own) if len(own) <= GROUP else min(GROUP, -(-len(own) // GROUP))

    def halved(part: np.ndarray, count: int) -> list[np.ndarray]:
        if count == 1:
            return [part]
        order = part[centers[part, int(np.ptp(centers[part], axis=0).argmax())].argsort(kind="stable")]
        few = count // 2
        middle = len(part) * few // count
        return halved(order[:middle], few) + halved(order[middle:], count - few)

    return halved(own, count)


def _around(entries: list[tuple[np.ndarray, float, int]]) -> tuple[np.ndarray, float]:
    """A float32 ball that holds these: steps of falling length towards the one that is farthest."""
    centers, radii = np.array([entry[0] for entry in entries]), np.array([entry[1] for entry in entries])

    def reaches(center: np.ndarray) -> np.ndarray:
        x, y, z = (centers - center).T
        return np.sqrt(x * x + y * y + z * z) + radii

    center = centers[int(radii.argmax())]
    best, least = center, np.inf
    for step in range(1, 101):
        far = reaches(center)
        k = int(far.argmax())
        if far[k] < least:
            best, least = center, far[k]
        center = center + (centers[k] - center) * (1 - radii[k] / far[k] if far[k] else 0.0) / (step + 1)
    best = best.astype(np.float32).astype(np.float64)
    return best, float(round_up(reaches(best).max() / INWARDS))


@dataclass(frozen=True, eq=False)
class Balls:
    """Balls that together hold a mesh, and their tree; see ``Balls.of``.

    Attributes:
        centers: ``(K, 3)`` float32, read-only, in the mesh's coordinates.
        radii: ``(K,)`` float32, read-only.
        mesh: Digest of the mesh, its margin included.
        name: Of the mesh.

    Example:
        >>> balls = wb.pairs.Balls.of(mesh, 64)
        >>> balls.certify(mesh).proven
        True
    """

    centers: np.ndarray
    radii: np.ndarray
    mesh: str
    name: str = "mesh"
    info: dict = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, shape in (("centers", (len(self.radii), 3)), ("radii", (len(self.radii),))):
            value = np.array(getattr(self, name), order="C")
            if value.dtype != np.float32 or value.shape != shape or not np.isfinite(value).all():
                raise BounderError(f"balls: expected {name} as finite float32 numbers of shape {shape}")
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        if not 1 <= len(self.radii) <= MOST or not (self.radii >= 0).all():
            raise BounderError(f"balls: expected 1 to {MOST:,} radii of at least 0, got {len(self.radii):,}")

    @classmethod
    def of(cls, mesh, count: int = 512, *, seed: int = 0) -> "Balls":
        """Balls that hold a mesh, proven.

        Args:
            mesh: A ``Mesh``, or what ``load_shape`` makes one of. Of an open mesh the surface is held.
            count: How many balls at most, from 8 to 32,768. Four times as many stand out about half as far.
            seed: Of the sample points.

        Raises:
            ShapeError: If it is no mesh at rest, or lies too far from its origin.
            BounderError: For another count.

        Example:
            >>> len(wb.pairs.Balls.of(mesh, 16).radii) <= 16
            True
        """
        if isinstance(count, bool) or not isinstance(count, int | np.integer) or not GROUP <= count <= MOST:
            raise BounderError(f"count must be a whole number from {GROUP} to {MOST:,}, got {count!r}")
        mesh = _mesh_of(mesh)
        centers, radii, by = _found(mesh, int(count), np.random.default_rng(seed))
        radii += mesh.margin
        size = float((mesh.upper - mesh.lower).max())
        search_mesh(mesh, centers, radii, max(by / 16, size * FINEST), grow=True)
        made = centers.astype(np.float32), round_up(radii).astype(np.float32)
        return cls(*made, mesh.digest, mesh.name, {"seed": int(seed)})

    def certify(self, mesh, budget: float = 900.0) -> Certificate:
        """Prove from the balls and the mesh alone that they hold it.

        Args:
            mesh: As ``of`` takes it.
            budget: Seconds.

        Returns:
            A certificate of kind ``"proven"``, ``"refuted"`` (with a point of the mesh that no ball holds),
            ``"undecided"`` or ``"inapplicable"`` (another mesh).

        Example:
            >>> balls.certify(mesh).kind, balls.certify(mesh.dilated(0.1)).kind
            ('proven', 'inapplicable')
        """
        started = working_seconds()

        def result(kind: str, message: str, boxes: int = 0, point: np.ndarray | None = None) -> Certificate:
            spent, place = round(working_seconds() - started, 3), None if point is None else point.tolist()
            about = {"indicator": self.mesh, "cells": 0, "object": self.name}
            return Certificate(
                kind, BALLS, [], 0.0, 0.0, 0.0, [], boxes, spent, counterexample=place, message=message, **about
            )

        try:
            mesh = _mesh_of(mesh)
        except ShapeError as error:
            return result("inapplicable", str(error))
        if mesh.digest != self.mesh:
            return result("inapplicable", f"these balls hold {self.name}, and {mesh.name} is another mesh")
        centers, radii = self.centers.astype(np.float64), self.radii.astype(np.float64)
        size = float((mesh.upper - mesh.lower).max())
        found = search_mesh(mesh, centers, radii, LEAST_SIDE * size, started + budget)
        if found.complete:
            held = "the solid" if mesh.watertight else "the surface"
            return result("proven", f"{len(radii)} balls hold {held} of {mesh.name}.", found.boxes)
        if found.bare is not None:
            return result("refuted", "a point of the mesh lies in no ball", found.boxes, found.bare)
        return result("undecided", "time is over, or a small box is neither in a ball nor certainly empty", found.boxes)

    @cached_property
    def tree(self) -> Tree:
        """The tree over the balls."""
        return Tree.of(self.centers, self.radii)

    def arrays(self, device: str | None = None) -> tuple[wp.array, wp.array]:
        """The tree's slots and links as flat arrays on a device, for ``PairData``."""
        slots, links = self.tree
        where = device_of(device)
        return wp.array(slots.reshape(-1), dtype=float, device=where), wp.array(links.reshape(-1), device=where)

    @property
    def nbytes(self) -> int:
        """Bytes of the tree, as a query reads it."""
        return self.tree.slots.nbytes + self.tree.links.nbytes

    def save(self, path: str | os.PathLike) -> None:
        """Write one ``.safetensors`` file, whole or not at all; raises ``FileFormatError``.

        Example:
            >>> balls.save("balls.safetensors")
            >>> len(wb.pairs.Balls.load("balls.safetensors").radii) == len(balls.radii)
            True
        """
        document = {"format": 1, "method": BALLS, "indicator": self.mesh, "name": self.name, "info": self.info}
        write(path, {"centers": self.centers, "radii": self.radii}, document)

    @classmethod
    def load(cls, path: str | os.PathLike) -> "Balls":
        """Read what ``save`` wrote; raises ``FileFormatError`` for anything else.

        Example:
            >>> balls.save("balls.safetensors")
            >>> wb.pairs.Balls.load("balls.safetensors").name == balls.name
            True
        """
        tensors, document = read(file_path(path))
        if document.get("method") != BALLS:
            raise FileFormatError(f"{path}: expected balls, got a bounder of method {document.get('method')!r}")
        try:
            about = document["indicator"], document["name"], document["info"]
            if set(tensors) != {"centers", "radii"} or [type(value) for value in about] != [str, str, dict]:
                raise FileFormatError(f"{path}: a field of the balls is missing or of the wrong type")
            return cls(tensors["centers"], tensors["radii"], *about)
        except (KeyError, BounderError) as error:
            raise FileFormatError(f"{path}: {error}") from error

    def __repr__(self) -> str:
        return f"<{len(self.radii):,} balls around {self.name}, {self.nbytes:,} bytes>"


def _mesh_of(mesh) -> Mesh:
    """A mesh at rest; raises ``ShapeError`` for anything else."""
    found = shapes.load_shape(mesh)
    if not isinstance(found, Mesh):
        raise ShapeError(f"{found.name}: balls hold meshes at rest near their origin, got {type(found).__name__}")
    return found
