"""Balls that hold the links of a robot: found, kept as URDF or YAML, and proven, whoever made them.

*What is held* is each link's collision geometry of a URDF file: boxes, cylinders, spheres and capsules as solids, the
surface of a mesh, and what its closed parts enclose (there with vertices in float32).

*The proof* halves the triangles of meshes, and tetrahedra of solids, until each lies in one ball; it does if its
corners do. Around what is round lies a polyhedron of many sides, which is halved; a copy of it within the body moves
along. Corners that lie in the body bound how far it reaches out of the balls from below, and pieces that are left from
above, in float64 with a bound of its rounding. What closed meshes enclose is proven as in ``balls``.

*Which balls.* A ball that touches the surface from inside (``balls``) and grows by e stands out of the link by about e.
For each link one such candidate after another is taken, each time for the link whose e is largest. After each, points
go to the ball that grows least for them, and balls to the candidate that grows least for its points, in turns (the
k-centre problem by Lloyd's steps).
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import warp as wp
from scipy.spatial import ConvexHull

from warp_bounding.arms.urdf import Element, links_of, mesh_data, naming, shape_of
from warp_bounding.errors import BounderError, FileFormatError, ShapeError
from warp_bounding.pairs.balls import INWARDS, LEAST_SIDE, MOST, medial, search_mesh
from warp_bounding.rigid import moved, ring
from warp_bounding.runtime.launch import working_seconds
from warp_bounding.runtime.progress import Progress, reported
from warp_bounding.runtime.whole_file import file_path, write_whole
from warp_bounding.shapes.formats.reading import import_optional, reading
from warp_bounding.shapes.mesh import Mesh

SIDES, FACETS = 64, 600  # sides of the prism around a cylinder; corners of the polyhedron around a ball
THIN = 1e-9  # relative: more than Qhull rounds in its faces
ROUNDED = 2.0**-44  # of the largest coordinate: more than all halvings and a pose round
PRECISION = 0.01  # relative: how well it is known how far a link reaches out
AT_ONCE = 1 << 18  # pieces times balls
CANDIDATES, MORE, DENSER = 800, 20, 4  # of a link: at least, for a ball, and points on the surface for a candidate
CORNERS = 400  # of a link's meshes, and points within it, at most
LLOYD = 10  # steps at most
FINE = 1 / 50  # of e: pieces that small make balls grow
DIGITS = 6  # after the point, of what is written: micrometres
YAML = (".yaml", ".yml")
SUFFIXES = (".urdf", *YAML)


@dataclass(frozen=True)
class LinkHeld:
    """Whether the balls of a link hold it.

    Attributes:
        kind: ``"proven"``, ``"refuted"``, or ``"undecided"``: time was over, or it is too close to tell.
        balls: How many.
        point: ``(x, y, z)`` of the link's frame, in the link and in no ball; ``None`` if none was found.
        outside: Metres from that point to the nearest ball at least; no point of the link is much farther.
        growth: Metres by which all radii must grow so that the balls hold the link, proven; infinite without balls and
            where time was over.
        seconds: How long it took.

    Example:
        >>> wb.pairs.RobotBalls({"base": [[0, 0, 0, 0.05]]}).certify("arm.urdf")["base"].kind
        'refuted'
    """

    kind: str
    balls: int
    point: tuple[float, float, float] | None
    outside: float
    growth: float
    seconds: float

    @property
    def proven(self) -> bool:
        """Whether the balls hold the link for certain."""
        return self.kind == "proven"

    def __str__(self) -> str:
        if self.proven:
            return f"proven, {self.balls} balls"
        if not self.balls:
            return "refuted, it has no balls"
        mend = f"radii larger by {1000 * self.growth:.4g} mm hold it" if self.growth < np.inf else "time is over"
        if self.kind == "undecided":
            return f"undecided, {self.balls} balls; {mend}"
        place = ", ".join(f"{x:.6g}" for x in self.point)
        return f"refuted, ({place}) is {1000 * self.outside:.4g} mm outside of its {self.balls} balls; {mend}"


@dataclass(frozen=True, eq=False)
class RobotBalls:
    """Balls of a robot's links; see ``RobotBalls.of``.

    Attributes:
        links: Of each link's name ``(K, 4)`` float64: centres in the link's frame and radii, metres.
        name: Of the robot.
        urdf: The robot's URDF, as text, whose collision geometry the balls replace when they are saved; may be empty.

    Example:
        >>> balls = wb.pairs.RobotBalls.of("arm.urdf", 12)
        >>> all(link.proven for link in balls.certify("arm.urdf").values())
        True
    """

    links: Mapping[str, np.ndarray]
    name: str = "robot"
    urdf: str = ""

    def __post_init__(self):
        found = {}
        for link, balls in self.links.items():
            balls = np.array(balls, dtype=np.float64).reshape(-1, 4)
            if not np.isfinite(balls).all() or (balls[:, 3] < 0).any():
                raise BounderError(f"link {link}: expected balls of finite numbers, radii of at least 0")
            balls.setflags(write=False)
            found[link] = balls
        object.__setattr__(self, "links", found)

    @classmethod
    def of(
        cls,
        urdf: str | os.PathLike,
        count: int,
        *,
        seed: int = 0,
        upright: bool | None = None,
        progress: Progress | bool | None = None,
    ) -> "RobotBalls":
        """Balls that hold all links of a robot, proven.

        Args:
            urdf: The robot's file.
            count: How many balls at most, for all links. Each link gets so many that the largest protrusion is least.
            seed: Of the sample points.
            upright: As ``load_urdf`` takes it.
            progress: Called with done and total; ``None`` for a bar, ``False`` for nothing.

        Raises:
            ShapeError: For what is no URDF, a mesh that is missing, or a robot without collision geometry.
            BounderError: For a count of less than a ball a link.

        Example:
            >>> sum(len(balls) for balls in wb.pairs.RobotBalls.of("arm.urdf", 12).links.values()) <= 12
            True
        """
        root, links = _read(urdf, upright)
        if isinstance(count, bool) or not isinstance(count, int | np.integer) or not len(links) <= count <= MOST:
            raise BounderError(
                f"balls must be a whole number from {len(links)}, one for each link with collision geometry, to "
                f"{MOST:,}, got {count!r}"
            )
        rng, chosen, found, total = np.random.default_rng(seed), {}, {}, count + len(links)
        with reported(progress, "balls") as told:

            def tell(done: int, link: str) -> None:
                if told:
                    told(done, total, link)

            for link, parts in links.items():
                tell(len(chosen), link)
                chosen[link] = _Chosen(parts, rng, count // len(links))
            for given in range(len(links), count):
                link = max(chosen, key=lambda each: chosen[each].by)
                if not chosen[link].add():
                    break
                tell(given, link)
            for number, (link, parts) in enumerate(links.items()):
                tell(count + number, link)
                found[link] = _proven(parts, *chosen[link].balls, chosen[link].by)
        return cls(found, root.get("name") or Path(urdf).stem, ElementTree.tostring(root, encoding="unicode"))

    def certify(
        self,
        urdf: str | os.PathLike,
        *,
        budget: float = 900.0,
        upright: bool | None = None,
        progress: Progress | bool | None = None,
    ) -> dict[str, LinkHeld]:
        """Prove of each link of a robot that its balls hold it, or find a point of it outside of them.

        Args:
            urdf: The robot's file; links without collision geometry need no balls.
            budget: Seconds for all links.
            upright: As ``load_urdf`` takes it.
            progress: As in ``of``.

        Raises:
            ShapeError: For what is no URDF, a mesh that is missing, or a robot without collision geometry.

        Example:
            >>> none = wb.pairs.RobotBalls({})
            >>> none.certify("arm.urdf")["upper"].kind
            'refuted'
        """
        end, found, none = working_seconds() + budget, {}, np.empty((0, 4))
        links = _read(urdf, upright)[1]
        with reported(progress, "certify") as told:
            for link, parts in links.items():
                if told:
                    told(len(found), len(links), link)
                found[link] = _held(parts, self.links.get(link, none), end)
        return found

    def save(self, path: str | os.PathLike) -> None:
        """Write a ``.urdf`` file, the robot's own with these balls as collision geometry, or ``.yaml`` for cuRobo.

        Raises ``FileFormatError`` for another suffix, or for URDF where the balls are not of one.

        Example:
            >>> wb.pairs.RobotBalls.of("arm.urdf", 12).save("arm_balls.yaml")
            >>> len(wb.pairs.RobotBalls.load("arm_balls.yaml").links)
            4
        """
        suffix = checked_suffix(path)
        text = _yaml(self.links) if suffix in YAML else self._as_urdf(path)
        write_whole(path, text.encode(), suffix)

    def _as_urdf(self, path: str | os.PathLike) -> str:
        if not self.urdf:
            raise FileFormatError(f"{path}: these balls are of no URDF file; write {' or '.join(YAML)}")
        root = ElementTree.fromstring(self.urdf)
        for link in root.findall("link"):
            for part in link.findall("collision"):
                link.remove(part)
            for *center, radius in self.links.get(link.get("name"), ()):
                part = ElementTree.SubElement(link, "collision")
                ElementTree.SubElement(part, "origin", xyz=" ".join(map(_decimal, center)), rpy="0 0 0")
                geometry = ElementTree.SubElement(part, "geometry")
                ElementTree.SubElement(geometry, "sphere", radius=_decimal(radius))
        ElementTree.indent(root)
        return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"

    @classmethod
    def load(cls, path: str | os.PathLike) -> "RobotBalls":
        """Read balls from a ``.urdf`` file, whose collision geometry are spheres, or ``.yaml`` as cuRobo reads it.

        Balls of a negative radius, which cuRobo does not check, are left out.

        Raises ``FileFormatError`` for another suffix, ``ShapeError`` for a file that holds something else.

        Example:
            >>> wb.pairs.RobotBalls.of("arm.urdf", 12).save("arm_balls.urdf")
            >>> wb.pairs.RobotBalls.load("arm_balls.urdf").name
            'arm'
        """
        suffix, path = checked_suffix(path), file_path(path)
        if suffix in YAML:
            with reading(path, "collision_spheres: of each link balls with center and radius"):
                return cls(_from_yaml(path), path.stem)
        with naming(path):
            root, links = links_of(path)
            found = {
                link: _spheres(element) for link, element in links.items() if element.find("collision") is not None
            }
        return cls(found, root.get("name") or path.stem, ElementTree.tostring(root, encoding="unicode"))

    def __repr__(self) -> str:
        return f"<{sum(map(len, self.links.values())):,} balls around {len(self.links)} links of {self.name}>"


# --- Files ------------------------------------------------------------------------------------------------------------


def checked_suffix(path: str | os.PathLike) -> str:
    """The suffix of a file of balls; ``FileFormatError`` for another one."""
    suffix = file_path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise FileFormatError(f"{path}: expected a name that ends with {', '.join(SUFFIXES)}")
    return suffix


def _decimal(x: float) -> str:
    return np.format_float_positional(x, trim="0")


def _yaml(links: Mapping[str, np.ndarray]) -> str:
    lines = ["collision_spheres:"]
    for link, balls in links.items():
        lines.append(f'  "{link}":')
        for *center, radius in balls:
            lines.append(f"    - center: [{', '.join(map(_decimal, center))}]\n      radius: {_decimal(radius)}")
    return "\n".join(lines) + "\n"


def _from_yaml(path: Path) -> dict[str, np.ndarray]:
    found = import_optional("yaml", "pyyaml", path).safe_load(path.read_text(encoding="utf-8-sig"))
    for key in ("robot_cfg", "kinematics", "collision_spheres"):
        found = found.get(key, found) if isinstance(found, Mapping) else found
    links = {}
    for link, balls in found.items():
        balls = [(*map(float, ball["center"]), float(ball["radius"])) for ball in balls]
        links[str(link)] = [ball for ball in balls if not ball[3] < 0]
    return links


def _spheres(link: Element) -> list[tuple[float, ...]]:
    found = []
    for part in link.findall("collision"):
        with naming(f"link {link.get('name')}"):
            kind, sizes, pose = shape_of(part)
            if kind != "sphere":
                raise ShapeError(f"expected balls, got {kind}; the balls come first, then the robot")
        found.append((*pose[:3, 3], sizes["radius"]))
    return found


# --- Geometry ---------------------------------------------------------------------------------------------------------


class _Part(NamedTuple):
    """A piece of a link's collision geometry.

    Attributes:
        outer: ``(F, 3, 3)``, triangles of a surface, whose polyhedron holds what is solid.
        inner: The same triangles, moved into the body.
        solid: Whether it is solid and convex.
        ball: Centre and radius ``(4,)``, if it is one.
        mesh: The mesh, if it is one with closed parts.
    """

    outer: np.ndarray
    inner: np.ndarray
    solid: bool = True
    ball: np.ndarray | None = None
    mesh: Mesh | None = None

    @property
    def pieces(self) -> np.ndarray:
        """``(S, N, 4, 3)`` tetrahedra, of triangles flat ones: those to be held and, in the body, their copies."""
        both = np.stack([self.outer, self.inner]) if self.solid else self.outer[None]
        last = np.broadcast_to(both.mean(axis=(1, 2), keepdims=True), both[:, :, :1].shape)
        return np.concatenate([both, last if self.solid else both[:, :, 2:]], axis=2)


def _read(path: str | os.PathLike, upright: bool | None) -> tuple[Element, dict[str, list[_Part]]]:
    """A robot's URDF, and the parts of its links that have some, in the links' frames."""
    path, found = file_path(path), {}
    meshes = cache(lambda name: mesh_data(name, path, upright)[:2])
    with naming(path):
        root, links = links_of(path)
        for link, element in links.items():
            for part in element.findall("collision"):
                with naming(f"link {link}"):
                    found.setdefault(link, []).extend(_parts(*shape_of(part), meshes))
        if not found:
            raise ShapeError("expected links with collision geometry, got none")
    return root, found


def _parts(kind: str, sizes: dict, pose: np.ndarray, meshes) -> list[_Part]:
    """What one shape of a URDF file is made of."""
    if kind == "mesh":
        vertices, faces = meshes(sizes["filename"])
        scale = np.broadcast_to(sizes.get("scale", 1.0), 3)
        vertices, faces = moved(vertices * scale, pose), faces[:, ::-1] if scale.prod() < 0 else faces
        mesh = Mesh(vertices, faces, name=sizes["filename"])
        corners = vertices[faces]
        return [_Part(corners, corners, False, mesh=mesh if mesh.surface.closed.any() else None)]
    if kind == "box":
        x, y, z = sizes["size"] / 2
        box = moved(_prism(np.array([[x, y], [-x, y], [-x, -y], [x, -y]]), z), pose)
        return [_Part(box, box)]
    radius, half, found = sizes["radius"], sizes.get("length", 0.0) / 2, []
    if kind != "sphere":
        around = ring(SIDES) * radius
        outer, inner = around * ((1 + THIN) / np.cos(np.pi / SIDES)), around * (1 - THIN)
        found.append(_Part(moved(_prism(outer, half), pose), moved(_prism(inner, half * (1 - THIN)), pose)))
    for z in {-half, half} if kind != "cylinder" else ():
        center = moved(np.array([[0.0, 0.0, z]]), pose)[0]
        outer, inner = (center + radius * corners for corners in _polyhedra())
        found.append(_Part(outer, inner, ball=np.array([*center, radius]) if kind == "sphere" else None))
    return found


def _prism(around: np.ndarray, half: float) -> np.ndarray:
    """``(4N, 3, 3)``: triangles around a prism, its polygon ``(N, 2)`` counter-clockwise, z from -half to half."""
    low, high = (np.column_stack([around, np.full(len(around), z)]) for z in (-half, half))
    low_next, high_next = np.roll(low, -1, axis=0), np.roll(high, -1, axis=0)
    bottom, top = np.full_like(low, [0, 0, -half]), np.full_like(low, [0, 0, half])
    sides = [(bottom, low_next, low), (top, high, high_next), (low, low_next, high_next), (low, high_next, high)]
    return np.concatenate([np.stack(corners, axis=1) for corners in sides])


@cache
def _polyhedra() -> tuple[np.ndarray, np.ndarray]:
    """``(F, 3, 3)`` twice: triangles around the unit ball, and the same within it."""
    number = np.arange(FACETS) + 0.5
    z, turn = 1 - 2 * number / FACETS, np.pi * (1 + 5**0.5) * number
    points = np.column_stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z])
    hull = ConvexHull(points)
    corners = points[hull.simplices]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    turned = (across * hull.equations[:, :3]).sum(axis=1) < 0
    corners[turned] = corners[turned, ::-1]
    return corners * ((1 + THIN) / -hull.equations[:, 3].max()), corners * (1 - THIN)


# --- Proof ------------------------------------------------------------------------------------------------------------


def _halves(pieces: np.ndarray) -> np.ndarray:
    """Both halves of pieces ``(S, N, 4, 3)``, cut through the middle of the longest edge: ``(S, 2N, 4, 3)``."""
    first, second = np.triu_indices(4, 1)
    longest = ((pieces[0][:, first] - pieces[0][:, second]) ** 2).sum(axis=2).argmax(axis=1)
    row, first, second = np.arange(pieces.shape[1]), first[longest], second[longest]
    middle = (pieces[:, row, first] + pieces[:, row, second]) / 2
    left, right = pieces.copy(), pieces.copy()
    left[:, row, second], right[:, row, first] = middle, middle
    return np.concatenate([left, right], axis=1)


def _some(left: list[np.ndarray], most: int) -> np.ndarray:
    """The last pieces ``(S, N, 4, 3)``, at most so many, which are taken out."""
    pieces = left.pop()
    if pieces.shape[1] > most:
        left.append(pieces[:, most:])
    return pieces[:, :most]


def _distances(points: np.ndarray, balls: np.ndarray) -> np.ndarray:
    """``(..., K)``: distances of points ``(..., 3)`` from centres."""
    apart = points[..., None, :] - balls[:, :3]
    return np.sqrt((apart * apart).sum(axis=-1))


def _sides(pieces: np.ndarray) -> np.ndarray:
    """The longest sides of boxes around pieces ``(N, 4, 3)``."""
    return np.ptp(pieces, axis=1).max(axis=1)


def _held(parts: list[_Part], balls: np.ndarray, end: float) -> LinkHeld:
    """Whether balls ``(K, 4)`` hold a link; ``end`` as ``working_seconds`` counts."""
    started = working_seconds()
    outside, point, growth = np.inf, parts[0].inner[0, 0], np.inf
    if len(balls):
        outside, point, growth = _outside(parts, balls, end)
        for mesh in (part.mesh for part in parts if part.mesh is not None):
            outside, point, growth = _enclosed(mesh, balls, end, outside, point, growth)
    kind = "proven" if growth == 0 else "refuted" if outside > 0 else "undecided"
    place = tuple(map(float, point)) if kind == "refuted" else None
    far = max(float(outside), 0.0)
    return LinkHeld(kind, len(balls), place, far, float(growth), round(working_seconds() - started, 3))


def _outside(parts: list[_Part], balls: np.ndarray, end: float) -> tuple[float, np.ndarray | None, float]:
    """How far surfaces and solids reach out of balls at least, where, and the growth of radii that holds them."""
    left, outside, point, growth = [], -np.inf, None, 0.0
    reached = -np.inf  # by what is to be held, which is more than the link where that is round
    corners = np.concatenate([part.outer for part in parts]).reshape(-1, 3)
    rounded, least = ROUNDED * np.abs(corners).max(), LEAST_SIDE * np.ptp(corners, axis=0).max()
    for part in parts:
        if part.ball is not None:
            far = _distances(part.ball[:3], balls)
            reach = part.ball[3] + np.where(far > 0, far / INWARDS + rounded, 0.0)  # its own ball holds it exactly
            if (reach <= balls[:, 3]).any():
                continue
        left.append(part.pieces)
    while left:
        pieces = _some(left, max(1, AT_ONCE // len(balls)))
        far = _distances(pieces, balls)
        over = (far[0] / INWARDS + rounded - balls[:, 3]).max(axis=1).min(axis=1)
        around, under = (far[side] * INWARDS - rounded - balls[:, 3] for side in (0, -1))
        reached, under = max(reached, around.min(axis=2).max()), under.min(axis=2)
        if under.max() > outside:
            outside, point = under.max(), pieces[-1].reshape(-1, 3)[under.argmax()]
        open_ = over > max(reached * (1 + PRECISION), 0.0)
        done = ~open_ | (_sides(pieces[0]) <= least) | (working_seconds() > end)
        growth = max(growth, over[done].max(initial=0.0))
        if not done.all():
            left.append(_halves(pieces[:, ~done]))
    return outside, point, growth + rounded if growth > 0 else 0.0  # for what a sum of radius and growth rounds


def _enclosed(mesh: Mesh, balls: np.ndarray, end: float, outside: float, point: np.ndarray, growth: float) -> tuple:
    """What ``_outside`` returns, with what a closed mesh encloses."""
    centers, least = balls[:, :3].copy(), LEAST_SIDE * float((mesh.upper - mesh.lower).max())
    growth *= 1 + PRECISION
    while growth < np.inf:
        found = search_mesh(mesh, centers, balls[:, 3] + growth, least, end)
        if found.complete:
            break
        far = -np.inf if found.bare is None else (_distances(found.bare, balls) * INWARDS - balls[:, 3]).min()
        if far > outside:
            outside, point = far, found.bare
        growth = max(growth * (1 + PRECISION), far * (1 + PRECISION), growth + least)
        growth = np.inf if working_seconds() > end else growth
    return outside, point, growth


# --- Search -----------------------------------------------------------------------------------------------------------


@wp.kernel(enable_backward=False)
def _enclosing(mesh: wp.uint64, points: wp.array(dtype=wp.vec3), far: float, found: wp.array(dtype=bool)):
    i = wp.tid()
    found[i] = wp.mesh_query_point_sign_winding_number(mesh, points[i], far).sign < 0.0


class _Enclosed:
    """Which points triangles ``(F, 3, 3)`` enclose, about: whose winding number is over a half, of open meshes, too."""

    def __init__(self, triangles: np.ndarray, size: float):
        points, indices = wp.array(triangles.reshape(-1, 3), dtype=wp.vec3, device="cpu"), np.arange(3 * len(triangles))
        self.mesh = wp.Mesh(points, wp.array(indices, dtype=int, device="cpu"), support_winding_number=True)
        self.far = 10 * size

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """``(P,)`` bool for points ``(P, 3)``."""
        found = wp.empty(len(points), dtype=bool, device="cpu")
        given = [self.mesh.id, wp.array(points, dtype=wp.vec3, device="cpu"), self.far, found]
        wp.launch(_enclosing, len(points), given, device="cpu")
        return found.numpy()


class _Chosen:
    """Balls that are chosen for a link, more and more, from its candidates.

    Attributes:
        by: By how much they must grow to hold the sample points.
    """

    def __init__(self, parts: list[_Part], rng: np.random.Generator, count: int):
        triangles = np.concatenate([part.outer for part in parts])
        across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        area, size = np.sqrt((across * across).sum(axis=1)), float(np.ptp(triangles.reshape(-1, 3), axis=0).max())
        many = max(CANDIDATES, MORE * count)
        face = rng.choice(len(area), DENSER * many, p=area / area.sum() if area.any() else None)
        seeds = (triangles[face] * rng.dirichlet(np.ones(3), len(face))[:, :, None]).sum(axis=1)
        corners = rng.permutation(np.unique(triangles.reshape(-1, 3), axis=0))[:CORNERS]
        enclosed = _Enclosed(triangles, size)
        within = rng.uniform(corners.min(axis=0), corners.max(axis=0), (CORNERS, 3))
        within = within[enclosed(within)]
        touched, face = seeds[:many], face[:many]
        normals = across[face] / np.maximum(area[face, None], np.finfo(float).tiny)
        normals *= np.where(enclosed(touched - 1e-4 * size * normals), 1.0, -1.0)[:, None]
        centers, radii = medial(touched, normals, np.concatenate([seeds, corners]), size)
        inside = enclosed(centers)
        flat = np.concatenate([touched[::4], touched[~inside]])  # where nothing is enclosed balls sit on the surface
        self.centers = np.round(np.concatenate([centers[inside], flat]), DIGITS)
        self.radii = np.concatenate([radii[inside], np.zeros(len(flat))])
        candidates = np.column_stack([self.centers, self.radii]).astype(np.float32)
        points = np.concatenate([seeds, corners, within]).astype(np.float32)
        self.away = np.stack([_distances(points, ball[None])[:, 0] - ball[3] for ball in candidates])
        self.chosen = [int(self.away.max(axis=1).argmin())]

    @property
    def cost(self) -> np.ndarray:
        """By how much the ball that is nearest to each point must grow for it."""
        return self.away[self.chosen].min(axis=0)

    @property
    def by(self) -> float:
        return float(self.cost.max())

    def add(self) -> bool:
        """Choose one more; whether there was one."""
        cost = self.cost
        worst = cost.argmax()
        near = np.flatnonzero(self.away[:, worst] < cost[worst])
        if not len(near):
            return False
        left = np.minimum(self.away[near], cost)
        self.chosen.append(int(near[(np.maximum(left, 0.0) ** 2).sum(axis=1).argmin()]))
        before = np.inf
        for _ in range(LLOYD):
            owner = self.away[self.chosen].argmin(axis=0)
            for k in np.unique(owner):
                self.chosen[k] = int(self.away[:, owner == k].max(axis=1).argmin())
            if not self.by < before:
                break
            before = self.by
        return True

    @property
    def balls(self) -> tuple[np.ndarray, np.ndarray]:
        """Centres and radii, each point held by the one that grows least for it."""
        own = self.away[self.chosen]
        grown = np.full(len(self.chosen), -np.inf)
        np.maximum.at(grown, own.argmin(axis=0), own.min(axis=0))
        radii = self.radii[self.chosen] + grown
        used = radii >= 0
        return self.centers[self.chosen][used], radii[used]


def _proven(parts: list[_Part], centers: np.ndarray, radii: np.ndarray, by: float) -> np.ndarray:
    """Balls ``(K, 4)`` of these centres that hold a link for certain."""
    balls = np.column_stack([centers, radii])
    left = [part.pieces[:1] for part in parts]
    least = max(FINE * by, LEAST_SIDE * max(_sides(each.reshape(1, -1, 3))[0] for each in left))
    while left:
        pieces = _some(left, max(1, AT_ONCE // len(balls)))
        reach = _distances(pieces[0], balls).max(axis=1)
        missing = reach - balls[:, 3]
        best, row = missing.argmin(axis=1), np.arange(len(reach))
        bare = missing[row, best] > 0
        small = bare & (_sides(pieces[0]) <= least)
        np.maximum.at(balls[:, 3], best[small], reach[row, best][small])
        if (bare & ~small).any():
            left.append(_halves(pieces[:, bare & ~small]))
    while True:
        balls[:, 3] = np.ceil(balls[:, 3] * 10**DIGITS) / 10**DIGITS
        held = _held(parts, balls, np.inf)
        if held.proven:
            return balls
        balls[:, 3] += held.growth
