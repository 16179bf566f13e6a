"""``occupancy``, not conservative: the network of ``mlp``, trained with a symmetric loss (the paper's OccNet).

It answers *maybe* where the probability that the query meets the object is at least one half (``f >= 0``), as
occupancy networks do (Mescheder et al. 2019). It errs both ways alike: some queries that do meet the object are
denied. It shows what the asymmetric loss and the proof are for, and is of no use as a broad phase; it can never hold a
certificate.
"""

from warp_bounding.bounders.neural.mlp import ACTIVATION, HIDDEN, OCTAVES, Mlp
from warp_bounding.bounders.options import STEPS
from warp_bounding.certificates.certificate import Certificate
from warp_bounding.errors import BounderError

__all__ = ["Occupancy"]


class Occupancy(Mlp):
    """A network with false negatives: *maybe* where *yes* seems at least as likely as *no*. Tensors: ``Mlp``'s."""

    method = "occupancy"
    conservative = False
    options = (HIDDEN, ACTIVATION, OCTAVES, STEPS)

    def freeze(self, threshold: float, certificate: Certificate | None) -> "Occupancy":
        """Set the threshold; raises ``BounderError`` for a certificate, which this bounder cannot hold."""
        if certificate is not None:
            raise BounderError("occupancy: is not conservative and cannot hold a certificate")
        return super().freeze(threshold, None)

    def __repr__(self) -> str:
        return f"{super().__repr__()[:-1]}, not conservative>"
