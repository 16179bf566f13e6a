"""How tight and how fast bounders are."""

from warp_bounding.evaluation.rates import PROTOCOLS, Rates, evaluate, quick_rates

__all__ = ["PROTOCOLS", "Rates", "evaluate", "quick_rates"]
