"""A bounder as certificates and files see it: what they read of it, without knowing its method."""

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from warp_bounding.certificates.certificate import Certificate
from warp_bounding.coordinates.domain import Domain
from warp_bounding.coordinates.region_domain import RegionDomain

__all__ = ["Subject"]


class Subject(Protocol):
    """A bounder as certificates and files see it; every ``Bounder`` is one, and its docstring says what these are."""

    method: str
    conservative: bool
    domain: Domain | RegionDomain
    tensors: dict[str, np.ndarray]
    sizes: dict[str, Any]
    threshold: np.float32
    certificate: Certificate | None
    info: dict[str, Any]
    query_kind: str
    ndim: int
    provable: bool
    parts: Sequence["Subject"]

    def rounding_bound(self) -> float:
        """See ``Bounder``."""
