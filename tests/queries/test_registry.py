"""A kind of query is added from outside as it is added inside: one object in a mapping."""

import numpy as np
from bounding_shapes import shape

from warp_bounding.queries import QUERIES, SampledOracle, check_query, oracle, sample
from warp_bounding.queries.hard import HardPositives, draw_positives
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.queries.registry import locate


class Cuboid(type(QUERIES["box"])):
    """Boxes under another name."""

    name = "cuboid"


def test_a_kind_of_query_is_added_from_outside(monkeypatch, rng):
    monkeypatch.setitem(QUERIES, "cuboid", Cuboid())
    cuboid, grid = "cuboid", shape("blob")
    q = sample(check_query(cuboid), grid, 2000, rng)
    truth = oracle(cuboid, grid, "cpu")
    np.testing.assert_array_equal(truth(q), oracle("box", grid, "cpu")(q))
    np.testing.assert_array_equal(SampledOracle(cuboid, grid, "cpu")(q), SampledOracle("box", grid, "cpu")(q))
    assert truth(next(draw_positives(cuboid, grid, 100, 1, "cpu"))).all()
    hard, certain = HardPositives(cuboid, grid, device="cpu").draw(1, 0, 500)
    assert truth(hard.numpy()[certain.numpy() != 0]).all()
    domain, same = domain_of(grid, cuboid), domain_of(grid, "box")
    np.testing.assert_array_equal(domain.to_local(q), same.to_local(q))
    np.testing.assert_array_equal(domain.limit, same.limit)
    assert locate(cuboid, 3, False) == locate("box", 3, False)
    assert domain.tested_as_region
