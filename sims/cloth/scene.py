"""The scene of ``sims.cloth``: a square cloth above the Stanford bunny and a star, both fixed, as a Newton model.

The cloth is a grid of particles (balls) on springs; it does not meet itself. Newton makes contacts of particles with
shapes: where a particle's centre is within ``RADIUS + GAP`` of a mesh, of its inside or outside. What a bounder must
cover is therefore the mesh dilated by that and by Newton's rounding, ``Scene.margin``.

Limits: contacts are of particles only, so a sharp edge can stand between two of them.
"""

from dataclasses import dataclass
from functools import cache, cached_property
from math import ceil

import newton
import numpy as np
import warp as wp

import warp_bounding as wb
from sims.assets import asset_mesh, surface
from sims.cloth.star import star
from sims.prefitted import FitSpec
from warp_bounding.newton import margin_for

__all__ = ["DT", "GAP", "RADIUS", "SHAPES", "SPECS", "Scene", "dilated", "newton_mesh", "shape"]

SHAPES = ("bunny", "star")
RADIUS = 0.02  # of a particle, world units (the bunny is 1.6 of them high)
GAP = 0.01  # soft contact gap: contacts are made this far ahead
DT = 1.0 / 480.0
CELLS = {"resolution": 64}  # of methods that are made of cells; the others bound the meshes themselves
WORLD = 20.0  # largest coordinate of a particle or shape, in this scene and in the field
ROUNDED = 1.0e4  # margins are rounded up to a multiple of its inverse
HIDDEN = (16, 16)  # of all networks but `occupancy`; `bvh` has their memory, a kilobyte and a half
WIDER = (24, 24)  # of `distance`: a distance is more to tell than a side
SMALLER = (
    8,
    8,
)  # of `occupancy`: what it misses can be seen; of 16-16 it misses contacts, too, but the cloth shows little of it

WIDTH, DROP, FALLING = 3.1, 0.04, 1.0  # of the cloth; its height over the bunny's ears and its speed
MASS = 0.01  # of a particle, of a cloth of 65 x 65
SPRINGS = {
    (1, 0): 600.0,
    (0, 1): 600.0,
    (1, 1): 150.0,
    (-1, 1): 150.0,
    (2, 0): 60.0,
    (0, 2): 60.0,
}  # by columns and rows
FRICTION = 0.8
GRAVITY, FASTEST = 4.0, 2.5  # as in air: lighter than it is, and no particle is faster
JITTER = 1.0e-4  # of the first positions: no cloth is perfectly flat
DEEPEST = 0.5  # how far under a surface is looked; no point of the bunny is deeper than 0.43
RAYS = 3  # that confirm an inside sign

SPECS = {
    "aabb": FitSpec("aabb"),
    "kdop": FitSpec("kdop"),
    "bvh": FitSpec("bvh", options={"hidden": HIDDEN}, **CELLS),
    "voxels": FitSpec("voxels", **CELLS),
    "learned-kdop": FitSpec("learned-kdop", budget=20.0),
    "mlp": FitSpec("mlp", budget=90.0, options={"hidden": HIDDEN}),
    "distance": FitSpec("mlp", "distance", 60.0, {"hidden": WIDER}),  # which serves any gap
    "aabb+mlp": FitSpec("aabb+mlp"),
    "occupancy": FitSpec("occupancy", budget=30.0, options={"hidden": SMALLER}),
}


@cache
def shape(name: str) -> wb.shapes.Mesh:
    """The bunny that ships in warp-lang, or the star; y up."""
    return star() if name == "star" else asset_mesh("bunny")


@cache
def newton_mesh(name: str) -> newton.Mesh:
    """The same for Newton."""
    mesh = shape(name)
    return newton.Mesh(mesh.vertices, mesh.faces.reshape(-1))


def margin(name: str, gap: float = GAP) -> float:
    """What a bounder of a shape must be dilated by, its own units; for shapes of this size or larger.

    Args:
        name: Of the shape.
        gap: Soft contact gap, world units.
    """
    return ceil(ROUNDED * margin_for(newton_mesh(name), RADIUS + gap, world=WORLD)) / ROUNDED


@cache
def dilated(name: str, gap: float = GAP) -> wb.shapes.Mesh:
    """What a bounder of a shape must hold: the mesh, dilated by its margin."""
    return shape(name).dilated(margin(name, gap))


def places() -> dict[str, wp.transform]:
    """Where the shapes stand: the bunny beside the star, which leans towards the viewer."""
    lean = wp.quat_from_axis_angle(wp.vec3(1.0, 0.0, 0.0), 0.3)
    return {
        "bunny": wp.transform(wp.vec3(-0.5, 0.0, 0.0), wp.quat_identity()),
        "star": wp.transform(wp.vec3(0.9, 1.1, 0.0), lean),
    }


@wp.kernel(enable_backward=False)
def _depth(
    # inputs
    q: wp.array(dtype=wp.vec3),
    mesh: wp.uint64,
    to_shape: wp.transform,
    # outputs
    depth: wp.array(dtype=float),
):
    i, _ = wp.tid()
    x = wp.transform_point(to_shape, q[i])
    query = wp.mesh_query_point_sign_parity(mesh, x, DEEPEST)
    if query.result and query.sign < 0.0:
        query = wp.mesh_query_point_sign_parity(mesh, x, DEEPEST, RAYS)  # a wrong sign is rare: more rays confirm it
    if query.result and query.sign < 0.0:
        depth[i] = wp.max(depth[i], wp.length(x - wp.mesh_eval_position(mesh, query.face, query.u, query.v)))


@dataclass(frozen=True, eq=False)
class Scene:
    """What all runs share.

    Attributes:
        side: Particles along a side of the cloth.
        seed: Of the small irregularity that the cloth begins with.
    """

    side: int = 65
    seed: int = 0

    def __post_init__(self):
        """Check the size.

        Raises:
            BoundingError: If it makes no cloth.
        """
        if not 2 <= self.side <= 257:
            raise wb.BoundingError(f"side must be from 2 to 257 particles, got {self.side}")

    @property
    def particles(self) -> int:
        """How many."""
        return self.side**2

    @property
    def indices(self) -> dict[str, int]:
        """Of the shapes, in the model."""
        return {name: index for index, name in enumerate(SHAPES)}

    @cached_property
    def model(self) -> newton.Model:
        """The cloth and the shapes."""
        builder = newton.ModelBuilder(up_axis=newton.Axis.Y)
        surface = newton.ModelBuilder.ShapeConfig(margin=0.0, mu=FRICTION)
        for name, place in places().items():
            builder.add_shape_mesh(body=-1, xform=place, mesh=newton_mesh(name), cfg=surface)
        rng = np.random.default_rng(self.seed)
        q = self.first_positions() + rng.uniform(-JITTER, JITTER, (self.particles, 3))
        falling = [wp.vec3(0.0, -FALLING, 0.0)] * self.particles
        positions = [wp.vec3(*x) for x in q.tolist()]
        builder.add_particles(positions, falling, [MASS] * self.particles, [RADIUS] * self.particles)
        for (right, down), stiffness in SPRINGS.items():
            for i, j in self.neighbours(right, down).tolist():
                builder.add_spring(i, j, stiffness, 0.0, 0.0)
        model = builder.finalize(device="cpu")
        model.set_gravity((0.0, -GRAVITY, 0.0))
        model.soft_contact_mu, model.particle_max_velocity = FRICTION, FASTEST
        # The solver then leaves out contacts between particles.
        model.particle_max_radius, model.particle_grid = 0.0, None
        return model

    def first_positions(self) -> np.ndarray:
        """``(N, 3)`` float64: a level square, row by row."""
        along = np.linspace(-WIDTH / 2, WIDTH / 2, self.side)
        z, x = np.meshgrid(along, along, indexing="ij")
        height = float(shape("bunny").bounds[1, 1]) + RADIUS + DROP
        return np.stack([x, np.full_like(x, height), z], axis=-1).reshape(-1, 3)

    def neighbours(self, right: int, down: int) -> np.ndarray:
        """``(K, 2)`` int, all pairs of particles of which the second is so many columns and rows further."""
        number = np.arange(self.particles).reshape(self.side, self.side)
        columns, shifted = (
            slice(max(0, -right), self.side - max(0, right)),
            slice(max(0, right), self.side + min(0, right)),
        )
        return np.stack([number[: self.side - down, columns], number[down:, shifted]], axis=-1).reshape(-1, 2)

    @property
    def triangles(self) -> np.ndarray:
        """``(M, 3)`` int, of the cloth; for drawing."""
        number = np.arange(self.particles).reshape(self.side, self.side)
        a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
        return np.concatenate([np.stack([a, c, b], -1).reshape(-1, 3), np.stack([b, c, d], -1).reshape(-1, 3)])

    @cached_property
    def _surfaces(self) -> dict[str, wp.Mesh]:
        return {name: surface(shape(name).vertices, shape(name).faces, "cpu") for name in SHAPES}

    def depths(self, q: wp.array) -> np.ndarray:
        """How far under a surface points lie, by signed closest points of the meshes.

        Args:
            q: ``(N,)`` ``vec3``, world units.

        Returns:
            ``(N,)`` float32, world units; 0 for what is outside.
        """
        depth = wp.zeros(len(q), dtype=float, device="cpu")
        for name, place in places().items():
            inputs = [q, self._surfaces[name].id, wp.transform_inverse(place)]
            wp.launch(_depth, dim=len(q), inputs=inputs, outputs=[depth], device="cpu")
        return depth.numpy()

    def from_shape(self, name: str, points: np.ndarray) -> np.ndarray:
        """``(N, 3)`` float32, points of the world as a shape sees them."""
        place = np.array(places()[name], dtype=np.float64)
        turn = np.array(wp.quat_to_matrix(wp.quat(*place[3:])), dtype=np.float64).reshape(3, 3)
        return ((points - place[:3]) @ turn).astype(np.float32)

    def world_vertices(self, name: str) -> np.ndarray:
        """``(V, 3)`` float64, of a shape in its place."""
        place = np.array(places()[name], dtype=np.float64)
        turn = np.array(wp.quat_to_matrix(wp.quat(*place[3:])), dtype=np.float64).reshape(3, 3)
        return shape(name).vertices @ turn.T + place[:3]
