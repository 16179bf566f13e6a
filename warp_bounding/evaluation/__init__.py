"""How tight and how fast bounders are."""

from warp_bounding.evaluation.rates import PROTOCOLS, evaluate, quick_rates
from warp_bounding.evaluation.report import Rates

__all__ = ["PROTOCOLS", "Rates", "evaluate", "quick_rates"]
