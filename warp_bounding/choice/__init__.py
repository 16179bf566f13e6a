"""Which bounder for these queries, this narrow phase and this machine: candidates are fitted, measured and priced."""

from warp_bounding.choice.among import choose_among
from warp_bounding.choice.choose import choose
from warp_bounding.choice.plot import cost_plot
from warp_bounding.choice.result import Choice, Row

__all__ = ["Choice", "Row", "choose", "choose_among", "cost_plot"]
