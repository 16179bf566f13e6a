"""Example Cull.

A cloth falls on bunnies and stars, which stand on a ground plane among pillars, balls and blocks. Before each contact
pass of particles with shapes, a ``Cull`` takes out the pairs that cannot touch: of the meshes by proven
bounders of distances, of the ground and the other shapes in closed form. The contacts are the same, and so is every
step that the solver makes.

Success criteria:
- The cloth comes to lie on the ears and tips, and no particle is under the ground. (Contacts are of particles: a tip
  may stand between two of them.)
- On a CPU all positions are those of a run without the cull, to the bit; on CUDA, where the order of Newton's contacts
  is by chance, the contacts of the last state are.
- Most pairs are taken out.

Runs:
- `python -m sims.newton.example_cull` (a window), `--viewer usd --output-path cull.usd`, `--viewer null --num-frames
  100 --test`
- `python -m sims.newton.example_cull --viewer null --no-cull`: the same without, to compare
"""

import argparse
import statistics
import time
from importlib.util import find_spec

import newton
import newton.examples
import newton.viewer
import numpy as np
import warp as wp

import warp_bounding as wb
from sims.cloth.scene import SHAPES, newton_mesh
from sims.prefitted import stored
from warp_bounding.newton import Cull

__all__ = ["Example", "main"]

SPACING = 2.4  # from one mesh to the next, metres
RADIUS = 0.03  # of a particle
GAP = 0.02  # soft contact gap: contacts are made this far ahead
HEIGHT = 2.2  # at which the cloth begins, over the ears of the bunnies
ROUNDS = 21  # in which the two passes that are timed take turns
RECORDS = ("particle", "shape", "body_pos", "body_vel", "normal")


class Example:
    """A cloth over many shapes; see module."""

    def __init__(self, viewer, args):
        """Build the scene, the pipeline and, unless `args.cull` is false, the cull around it."""
        self.viewer, self.args = viewer, args
        self.fps, self.sim_substeps, self.sim_time, self.frames = 60, 8, 0.0, 0
        self.frame_dt = 1.0 / self.fps
        self.sim_dt = self.frame_dt / self.sim_substeps

        builder = newton.ModelBuilder(up_axis=newton.Axis.Y)
        builder.default_shape_cfg.mu = 0.8
        builder.add_ground_plane()
        across = max(1, int(np.ceil(np.sqrt(args.meshes))))
        self.width = SPACING * across
        of_meshes = self._add_meshes(builder, args.meshes, across)
        self._add_primitives(builder, across)
        cell = self.width / args.side
        builder.add_cloth_grid(
            pos=wp.vec3(-self.width / 2, HEIGHT, -self.width / 2),
            rot=wp.quat_from_axis_angle(wp.vec3(1.0, 0.0, 0.0), wp.pi * 0.5),
            vel=wp.vec3(0.0, -0.5, 0.0),
            dim_x=args.side,
            dim_y=args.side,
            cell_x=cell,
            cell_y=cell,
            mass=0.01,
            tri_ke=0.0,
            tri_ka=0.0,
            tri_kd=0.0,
            edge_ke=0.0,
            add_springs=True,
            spring_ke=300.0,
            spring_kd=0.0,
            particle_radius=RADIUS,
        )
        self.model = builder.finalize()
        self.model.soft_contact_mu = 0.8
        # The cloth does not meet itself.
        self.model.particle_max_radius, self.model.particle_grid = 0.0, None

        self.solver = newton.solvers.SolverXPBD(self.model, iterations=4)
        self.state_0, self.state_1 = self.model.state(), self.model.state()
        self.control = self.model.control()
        self.collision_pipeline = newton.CollisionPipeline(self.model, soft_contact_gap=GAP)
        self.contacts = self.collision_pipeline.contacts()
        self.cull = None
        if args.cull:
            device = str(self.model.device)
            files = {name: wb.load(stored("cloth", f"{name}-distance"), device=device) for name in SHAPES}
            self.cull = Cull(self.collision_pipeline, {index: files[name] for index, name in of_meshes.items()})
        self.viewer.set_model(self.model)
        self.capture()

    @staticmethod
    def create_parser():
        """Newton's options, and those of this example."""
        parser = newton.examples.create_parser()
        parser.add_argument("--meshes", type=_positive, default=9, help="Number of bunnies and stars.")
        parser.add_argument("--side", type=_positive, default=110, help="Cells along a side of the cloth.")
        parser.add_argument(
            "--cull", action=argparse.BooleanOptionalAction, default=True, help="Take out the pairs that cannot touch."
        )
        return parser

    def _add_meshes(self, builder, count: int, across: int) -> dict[int, str]:
        """Bunnies and stars by turns, turned; the names of their shapes by index."""
        rng, found = np.random.default_rng(0), {}
        for number in range(count):
            row, column = divmod(number, across)
            name = SHAPES[number % len(SHAPES)]
            lift = 0.0 if name == "bunny" else 0.9
            x, z = ((k + 0.5) * SPACING - self.width / 2 for k in (column, row))
            turn = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), float(rng.uniform(0, 2 * np.pi)))
            place = wp.transform(wp.vec3(x, lift, z), turn)
            found[builder.add_shape_mesh(body=-1, xform=place, mesh=newton_mesh(name))] = name
        return found

    def _add_primitives(self, builder, across: int) -> None:
        """A pillar, a ball, a block or a post on every crossing between the meshes."""
        upright = wp.quat_from_axis_angle(wp.vec3(1.0, 0.0, 0.0), -0.5 * wp.pi)
        adding = (
            lambda p: builder.add_shape_capsule(body=-1, xform=wp.transform(p, upright), radius=0.12, half_height=0.5),
            lambda p: builder.add_shape_sphere(body=-1, xform=wp.transform(p, wp.quat_identity()), radius=0.35),
            lambda p: builder.add_shape_box(
                body=-1, xform=wp.transform(p, wp.quat_identity()), hx=0.25, hy=0.4, hz=0.25
            ),
            lambda p: builder.add_shape_cylinder(body=-1, xform=wp.transform(p, upright), radius=0.2, half_height=0.6),
        )
        for number in range((across - 1) ** 2):
            row, column = divmod(number, across - 1)
            x, z = ((k + 1) * SPACING - self.width / 2 for k in (column, row))
            adding[number % len(adding)](wp.vec3(x, 0.5, z))

    def capture(self):
        """One frame as a graph, on CUDA; on a CPU the cull has more cores without."""
        self.graph = None
        if self.model.device.is_cuda:
            with wp.ScopedCapture() as capture:
                self.simulate()
            self.graph = capture.graph

    def simulate(self):
        """The substeps of a frame; the cull stands where the pipeline stood."""
        collide = self.collision_pipeline.collide if self.cull is None else self.cull.collide
        for _ in range(self.sim_substeps):
            self.state_0.clear_forces()
            self.viewer.apply_forces(self.state_0)
            collide(self.state_0, self.contacts)
            self.solver.step(self.state_0, self.state_1, self.control, self.contacts, self.sim_dt)
            self.state_0, self.state_1 = self.state_1, self.state_0

    def step(self):
        """One frame."""
        if self.graph:
            wp.capture_launch(self.graph)
        else:
            self.simulate()
        self.sim_time += self.frame_dt
        self.frames += 1

    def render(self):
        """Show it."""
        self.viewer.begin_frame(self.sim_time)
        self.viewer.log_state(self.state_0)
        self.viewer.log_contacts(self.contacts, self.state_0)
        self.viewer.end_frame()

    def test_final(self):
        """See the success criteria."""
        newton.examples.test_particle_state(
            self.state_0, "particles are above the ground", lambda q, qd: q[1] > -RADIUS
        )
        if self.cull is None:
            return
        self.cull.collide(self.state_0, self.contacts)
        if self.cull.culled < 0.5 * self.cull.pairs:
            raise ValueError(f"expected most pairs to be culled, got {self.cull.culled} of {self.cull.pairs}")
        own = _records(self.contacts)
        self.collision_pipeline.collide(self.state_0, self.contacts)
        if not all(np.array_equal(a, b) for a, b in zip(own, _records(self.contacts), strict=True)):
            raise ValueError("expected the contacts of all pairs, got others with the cull")
        if self.model.device.is_cuda:
            return
        other = type(self)(newton.viewer.ViewerNull(), _without_cull(self.args))
        for _ in range(self.frames):
            other.step()
        for name in ("particle_q", "particle_qd"):
            mine, its = (getattr(example.state_0, name).numpy() for example in (self, other))
            if not np.array_equal(mine, its):
                raise ValueError(
                    f"expected the same {name} as without the cull, got a difference of {np.abs(mine - its).max():g}"
                )

    def milliseconds(self) -> dict[str, float]:
        """Median time of a contact pass of the present state, with the cull and without, in turns."""
        passes = {"without": self.collision_pipeline.collide}
        if self.cull is not None:
            passes["with"] = self.cull.collide
        times: dict[str, list[float]] = {name: [] for name in passes}
        for turn in range(ROUNDS + 1):  # the first loads what is not loaded
            for name, collide in passes.items():
                wp.synchronize_device(self.model.device)
                begin = time.perf_counter()
                collide(self.state_0, self.contacts)
                wp.synchronize_device(self.model.device)
                if turn:
                    times[name].append(1e3 * (time.perf_counter() - begin))
        return {name: statistics.median(own) for name, own in times.items()}

    def report(self) -> str:
        """What the cull is worth in the present state, in a few lines."""
        took = self.milliseconds()
        lines = [f"{self.model.particle_count:,} particles, {self.model.shape_count} shapes, {self.model.device}"]
        if self.cull is None:
            return "\n".join([*lines, f"a contact pass: {took['without']:.2f} ms, without the cull"])
        ratio = took["without"] / took["with"]
        reported = (
            f"{ratio:.2f} times as fast" if ratio >= 1.0 else f"{1.0 / ratio:.2f} times as long: it does not pay here"
        )
        lines += [f"  {name:<22} {tally} pairs culled" for name, tally in self.cull.tally().items()]
        passes = f"a contact pass: {took['without']:.2f} ms, with the cull {took['with']:.2f} ms"
        lines += [f"{passes}, the cull's own time included: {reported}"]
        return "\n".join(lines)


def _positive(value: str) -> int:
    number = int(value) if value.isdigit() else 0
    if number < 1:
        raise argparse.ArgumentTypeError(f"must be a whole number of 1 at least, got {value!r}")
    return number


def _without_cull(args: argparse.Namespace) -> argparse.Namespace:
    return argparse.Namespace(**{**vars(args), "cull": False})


def _records(contacts) -> list[np.ndarray]:
    """Contacts, a row each, by particle and shape, because their order is by chance on CUDA."""
    count = int(contacts.soft_contact_count.numpy()[0])
    rows = [getattr(contacts, f"soft_contact_{name}").numpy()[:count] for name in RECORDS]
    order = np.lexsort((rows[1], rows[0]))
    return [row[order] for row in rows]


def main() -> None:
    """Run it as Newton runs its examples, and say what the cull was worth."""
    parser = Example.create_parser()
    if parser.parse_args().viewer == "gl" and find_spec("pyglet") is None:
        parser.error("the viewer gl needs pip install 'newton[examples]'; or take --viewer usd or --viewer null")
    viewer, args = newton.examples.init(parser)
    example = Example(viewer, args)
    newton.examples.run(example, args)
    print(example.report())


if __name__ == "__main__":
    main()
