"""The bodies: a bunny and a ring, the points that stand for their surfaces, balls that hold them, and how they start.

A denied pair has no contact: its meshes are farther apart than ``GAP``, and the narrow phase finds contacts up to
``CONTACT``, which is less by more than it rounds. Its points lie on the surface, up to rounding. A point is *inside*
another mesh by ``mesh_query_point_sign_parity``; what that is worth, ``sims.particles.scene`` says, and each run's
contacts are compared with the reference's.
"""

from pathlib import Path

import numpy as np
import warp as wp

import warp_bounding as wb
from sims.assets import asset_mesh, surface
from sims.pile.kernels import Bodies
from sims.prefitted import FOLDER

__all__ = ["HELD", "SCENES", "Scene", "hold", "shapes"]

SCENES, HELD = "pile-", FOLDER / "pairs"  # of files of bounders; where balls lie
BALLS, POINTS = 128, 128
RING = (0.38, 0.13, 48, 20)  # radii, and how many faces around each
SPACING, COLUMNS, LIFT = 1.15, 5, 0.8  # of bodies before they fall
DENSITY = 5.0


def shapes() -> dict[str, wb.shapes.Mesh]:
    """Both meshes, by scene: 1 wide, the centre of mass in the origin."""
    import trimesh

    bunny = asset_mesh("bunny")
    bunny = trimesh.Trimesh(bunny.vertices, bunny.faces, process=False)
    found = {"bunny": bunny, "ring": trimesh.creation.torus(*RING[:2], major_sections=RING[2], minor_sections=RING[3])}
    made = {}
    for name, mesh in found.items():
        vertices = (mesh.vertices - mesh.center_mass) / mesh.extents.max()
        made[SCENES + name] = wb.shapes.Mesh(vertices.astype(np.float32), np.asarray(mesh.faces), name=name)
    return made


def hold(folder: Path | None = None) -> dict[str, wb.pairs.Balls]:
    """Balls that hold the meshes, by scene; made anew and saved if a folder is given.

    Raises:
        BounderError: For balls of another mesh.
    """
    found = {}
    for scene, shape in shapes().items():
        path = (HELD if folder is None else Path(folder)) / f"{scene}-{BALLS}-balls.safetensors"
        if folder is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            wb.pairs.Balls.of(shape, BALLS).save(path)
        found[scene] = wb.pairs.Balls.load(path)
        if found[scene].mesh != shape.digest:
            raise wb.BounderError(f"{path.name}: balls of another mesh than {scene}; --refit makes them")
    return found


def _spread(shape: wb.shapes.Mesh) -> np.ndarray:
    """Points of the surface, ``(POINTS, 3)``: each next one is the farthest from those before, of a random many."""
    points = shape.points(30 * POINTS, np.random.default_rng(0))
    away, chosen = np.full(len(points), np.inf), [0]
    for _ in range(POINTS - 1):
        away = np.minimum(away, ((points - points[chosen[-1]]) ** 2).sum(axis=1))
        chosen.append(int(away.argmax()))
    return points[chosen].astype(np.float32)


class Scene:
    """What all runs share, on a device.

    Attributes:
        shapes: By scene.
        kinds: ``(N,)``: 0 a bunny, 1 a ring; or of other meshes the number.
        start: ``(N, 7)`` float32, places before they fall.
        bodies: For kernels.
    """

    def __init__(
        self,
        count: int,
        seed: int = 0,
        device: str | None = None,
        given: dict[str, wb.shapes.Mesh] | None = None,
    ):
        """Hang bodies above the box, bunnies and rings in turns, or other meshes, centres of mass in the origin."""
        import trimesh

        self.device, self.shapes, rng = wp.get_device(device), given or shapes(), np.random.default_rng(seed)
        self.kinds = np.arange(count) % len(self.shapes)
        place = np.stack(np.unravel_index(np.arange(count), (count // COLUMNS**2 + 1, COLUMNS, COLUMNS)), axis=1)
        x = SPACING * place[:, ::-1]
        x += rng.uniform(-0.08, 0.08, x.shape)
        x += np.array([-SPACING * (COLUMNS - 1) / 2] * 2 + [LIFT])
        turns = rng.normal(size=(count, 4))
        turns /= np.linalg.norm(turns, axis=1, keepdims=True)
        self.start = np.concatenate([x, turns], axis=1).astype(np.float32)
        own = list(self.shapes.values())
        solids = [trimesh.Trimesh(shape.vertices, shape.faces, process=False) for shape in own]
        masses = [DENSITY * solid.volume for solid in solids]
        inverse = [np.linalg.inv(DENSITY * solid.moment_inertia) for solid in solids]
        self.surfaces = [surface(shape.vertices, shape.faces, self.device) for shape in own]
        farthest = [1.00001 * np.linalg.norm(shape.vertices, axis=1).max() for shape in own]
        bodies = self.bodies = Bodies()
        bodies.side = SPACING * COLUMNS / 2
        for name, values, dtype in (
            ("kinds", self.kinds.astype(np.int32), int),
            ("meshes", [mesh.id for mesh in self.surfaces], wp.uint64),
            ("points", np.stack([_spread(shape) for shape in own]), wp.vec3),
            ("middles", [(shape.upper + shape.lower) / 2 for shape in own], wp.vec3),
            ("halves", [(shape.upper - shape.lower) / 2 for shape in own], wp.vec3),
            ("radii", farthest, float),
            ("masses", masses, float),
            ("inertias", np.stack(inverse), wp.mat33),
        ):
            setattr(bodies, name, wp.array(values, dtype=dtype, device=self.device))
