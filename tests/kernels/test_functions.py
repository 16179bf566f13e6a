"""A function answers *maybe* to data that are not its own, or not all there; and the two ways to write a kernel for it."""

import numpy as np
import pytest
import rebound
import warp as wp
from asked_functions import QUERIES, ask, bounders, remade
from bounding_shapes import shape

from warp_bounding.bounders import METHODS
from warp_bounding.kernels.functions import Data
from warp_bounding.kernels.source import LABEL
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.runtime.native import identity, unique_name


@pytest.mark.parametrize("query", QUERIES)
def test_data_of_another_source_are_answered_with_maybe(query, device):
    everyone = bounders(query, device)
    for source, bounder in everyone.items():
        assert (ask(bounder, bounder.data) == 0).all()
        for other, foreign in everyone.items():
            assert (ask(bounder, foreign.data) == (source != other)).all(), f"{source} took data of {other}"


@pytest.mark.parametrize("query", QUERIES)
def test_data_that_are_too_short_are_answered_with_maybe(query, device):
    everything = slice(None)
    for bounder in bounders(query, device).values():
        data, source = bounder.data, bounder.source
        assert (ask(bounder, remade(data, everything, everything)) == 0).all()
        assert (ask(bounder, Data()) == 1).all()
        lengths = {0, 1, LABEL - 1, LABEL, source.start - 1, source.start, len(data.parameters) - 1}
        for length in sorted(lengths):
            assert (ask(bounder, remade(data, slice(length), everything)) == 1).all()
        for length in {0, len(data.words) - 1}:
            assert (ask(bounder, remade(data, everything, slice(length))) == 1).all()
        for name, dtype in (("parameters", wp.float32), ("words", wp.uint32)):
            strided = remade(data, everything, everything)
            twice = np.repeat(getattr(data, name).numpy(), 2)
            setattr(strided, name, wp.array(twice, dtype=dtype, device=bounder.device)[::2])
            assert (ask(bounder, strided) == 1).all()


def test_data_of_an_equal_source_are_taken(device):
    """Functions are compiled for sizes, not for values: bounders of the same sizes share one, each with its own data."""
    grid, domain = shape("c"), domain_of(shape("c"))
    small, large = (METHODS["bvh"].fit(grid, domain, leaves=leaves, device=device) for leaves in (2, 9))
    assert large.func is small.func
    assert len(large.data.parameters) != len(small.data.parameters)
    assert (ask(small, large.data) == 0).all()
    assert (ask(large, small.data) == 0).all()


def test_the_front_survives_every_copy_and_tells_sources_apart():
    sources = [source for query in QUERIES for source in bounders(query, "cpu")]
    assert len({source.tag for source in sources}) == len({unique_name(source, "test") for source in sources})
    assert len({source.tag for source in sources}) == len(sources)
    for source in sources:
        label = source.label(10**6, 3)
        assert np.isfinite(label).all()  # a float that is not may change in a copy
        assert label.view(np.uint32).tolist() == [*source.tag, 10**6, 3]


def test_equal_sources_have_equal_names_however_they_are_written():
    source = next(source for source in bounders("point", "cpu") if source.name == "voxels")
    twin = type(source)(np.int64(source.ndim), False, shape=tuple(np.int64(r) for r in source.shape))
    assert twin == source
    assert identity(twin) == identity(source)
    assert twin.tag == source.tag


def test_a_kernel_keeps_its_function_when_the_module_gets_another(rng):
    """README's kernel, twice in one module and with the same names; and the same with a global function, which is rebound."""
    x = (rng.random((4000, 3)) * 1.2 - 0.1).astype(np.float32)
    expected = [bounder.query(x).numpy() for bounder in rebound.BOUNDERS]
    assert (expected[0] > expected[1]).any()
    for kernels, kept in ((rebound.STEPS, True), (rebound.STEPS_BY_NAME, False)):
        for _ in range(2):  # the second time from a module that was built anew
            answers = [rebound.launch(k, b, x) for k, b in zip(kernels, rebound.BOUNDERS, strict=True)]
            for answer, right in zip(answers, expected, strict=True):
                assert (answer >= right).all()
                assert (answer == right).all() or not kept
            assert (answers[0].all()) == (not kept)
            kernels[0].module.unload()
