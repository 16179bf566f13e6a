"""Several bounders of one object as one that asks the cheap ones first, with what is proven of them."""

from warp_bounding.bounders.base import Bounder
from warp_bounding.bounders.cascade import Cascade
from warp_bounding.certificates.document import conjunction
from warp_bounding.errors import BounderError

__all__ = ["cascade"]

SAME = ("indicator", "margin", "resolution")  # entries of ``info`` that all parts must share


def cascade(*bounders: Bounder) -> Cascade:
    """A bounder that says *maybe* iff all of these do, asked in this order.

    Args:
        bounders: Bounders of the same queries of the same object, such as an ``aabb`` and an ``mlp``. A query costs no
            more than the bounders up to the first one that denies it.

    Returns:
        The cascade. It is proven if all parts are, statistical if one of them is, and without a certificate if one has
        none.

    Raises:
        BounderError: If they were made for different objects, margins, queries or domains, or cannot be put together
            (``Cascade.of``).

    Example:
        >>> both = wb.cascade(wb.fit(ball, method="sphere", device="cpu"), bounder)
        >>> both.method, both.certificate.proven
        ('cascade', True)
    """
    whole = Cascade.of(list(bounders))
    last = bounders[-1]
    for bounder in bounders:
        for key in SAME:
            if bounder.info.get(key) != last.info.get(key):
                got = f"{bounder.info.get(key)} and {last.info.get(key)}"
                raise BounderError(f"cascade: expected bounders of the same object, got {key} {got}")
    whole.info = {key: last.info.get(key) for key in (*SAME, "name", "grid_shape", "seed", "note")}
    whole.info["training"] = {"parts": [bounder.info.get("training") for bounder in bounders]}
    certificates = [bounder.certificate for bounder in bounders]
    if all(certificates):
        about = sorted({certificate.indicator for certificate in certificates})
        if len(about) > 1:
            raise BounderError(f"cascade: expected certificates of the same object, got {' and '.join(about)}")
        whole.freeze(float(whole.threshold), conjunction(certificates))
    return whole
