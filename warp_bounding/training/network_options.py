"""What a network is told besides its problem."""

from dataclasses import dataclass

from warp_bounding.bounders.mlp import CERTIFICATES, RECIPES
from warp_bounding.errors import BounderError

__all__ = ["NetworkOptions"]


@dataclass(frozen=True)
class NetworkOptions:
    """What kind of network, and how long it may take; see ``fit``."""

    hidden: tuple[int, ...]
    activation: str
    budget: float
    steps: int | None = None
    octaves: int = 0
    recipe: str = RECIPES[0]
    thresholds: int = 1
    certificate: str = CERTIFICATES[0]

    def __post_init__(self):
        if self.attested and self.thresholds > 1:
            raise BounderError("thresholds of parts are proven; a statistical certificate is for one threshold")

    @property
    def attested(self) -> bool:
        """Whether no proof is wanted."""
        return self.certificate != CERTIFICATES[0]

    @property
    def stored(self) -> dict:
        """The sizes that a bounder stores."""
        return {"hidden": list(self.hidden), "activation": self.activation, "octaves": self.octaves}
