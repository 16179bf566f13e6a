"""How long the proof of a network that is still being trained will take, and what follows for its training."""

from warp_bounding.proof import Search

__all__ = [
    "HOPEFUL",
    "MOST_REGION_PROOF",
    "MOST_SHAPE_PROOF",
    "UNTOLD",
    "WORTH_PROVING",
    "attest_seconds",
    "decay_for",
    "final_proof_seconds",
]

# Largest share of the budget that is reserved for the proof of rays or boxes, of cells and of other shapes; of these a
# proof is not tried where it is expected to take more than so many times as long.
MOST_REGION_PROOF, MOST_SHAPE_PROOF, HOPEFUL = 0.6, 0.35, 4.0
# The search of rays or boxes of a shape itself takes about so many times as long as that of coarse cells.
SHAPE_TIMES = 30.0
# The proof of the final network takes this many times as long as that of one at used fraction 0 and at 1, and in
# between a number linear in the used fraction: f gets steeper while it trains. Both are empirical.
PROOF_GROWTH = (4.2, 1.35)
# A search that did not end tells too little of what it has left, by about this factor: of the boxes of a 4D teapot it
# told 14 s of a proof that did not end in 21 s, with 21 % false positives then; taken at its word times 5, weights
# decayed, and the proof ended in 2.3 s, with 16.7 %.
UNTOLD = 5.0
# Where the proof of rays or boxes is expected to take more than the share DECAY_ABOVE, weights decay at the rate DECAY,
# times the factor by which it is exceeded, up to MOST_DECAY: smaller weights make proofs shorter.
DECAY_ABOVE, DECAY, MOST_DECAY = 0.3, 0.05, 0.2
# A proof ends with a gap, which lowers the threshold and makes false positives of more queries. Where these are
# expected to be more than this share of all queries the proof is given up, and training keeps its time.
WORTH_PROVING = 1e-2

# About the time of the million fresh positives that attest a threshold, of cells and of regions of other shapes, and the
# share of the budget that is left for it at most.
ATTEST_SECONDS, SHAPE_ATTEST_SECONDS, ATTEST_SHARE = 2.5, 12.0, 0.15


def final_proof_seconds(search: Search, used: float, of_cells: bool = True, untold: float = 1.0) -> float:
    """Seconds expected for the proof of the final network.

    Args:
        search: Of the network at a used fraction of its training time.
        used: That fraction.
        of_cells: Whether the object is a grid; of regions of other shapes ``search`` tells of coarse cells.
        untold: Factor of what a search that did not end says of the rest: ``UNTOLD`` of rays and boxes.
    """
    begin, end = PROOF_GROWTH
    seconds = search.seconds if search.complete else untold * search.needed
    return (begin + (end - begin) * used) * seconds * (1.0 if of_cells else SHAPE_TIMES)


def decay_for(expected: float, budget: float) -> float:
    """The rate at which the weights of a network of regions decay, where its proof is expected to take so many seconds."""
    longer = expected / (DECAY_ABOVE * budget)
    return min(DECAY * longer, MOST_DECAY) if longer > 1 else 0.0


def attest_seconds(budget: float, little: bool) -> float:
    """Seconds of a budget that are left for attesting: ``little`` of cells, and where a proof is expected instead."""
    return ATTEST_SECONDS if little else min(SHAPE_ATTEST_SECONDS, ATTEST_SHARE * budget)
