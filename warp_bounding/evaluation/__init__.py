"""How tight and how fast bounders are."""

from warp_bounding.evaluation.rates import PROTOCOLS, Rates, evaluate

__all__ = ["PROTOCOLS", "Rates", "evaluate"]
