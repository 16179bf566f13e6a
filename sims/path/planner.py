"""The roadmap of a 2D world; see ``sims.planning.roadmap``."""

from pathlib import Path

from sims.path.exact import ExactWorld
from sims.path.pictures import draw_one
from sims.path.worlds import World
from sims.planning.broad import BroadPhase
from sims.planning.roadmap import NEIGHBOURS, Roadmap

__all__ = ["NEIGHBOURS", "Example"]


class Example(Roadmap):
    """All problems of one world, planned at once; lengths are in cells."""

    def __init__(
        self,
        world: World,
        broad: BroadPhase | None = None,
        *,
        exact: ExactWorld | None = None,
        device: str = "cpu",
        **options,
    ):
        """Draw states and problems; they depend on the seed, not on the broad phase.

        Args:
            world: Where to plan.
            broad: What is asked first; nothing if ``None``.
            exact: The exact world, if there is one already.
            device: Warp device for a new one.
            options: Of ``Roadmap``.
        """
        super().__init__(world, exact or ExactWorld(world.grid, device), broad, **options)

    def render(self, folder: Path) -> list[Path]:
        """Draw roadmap and paths; see ``sims.path.pictures``."""
        return [draw_one(self, Path(folder))]
