"""The cull where no count is read back: inside a captured graph, and wherever the caller wants it."""

import os

import numpy as np
import pytest
import warp as wp

import warp_bounding as wb

newton = pytest.importorskip("newton", reason="Newton is not installed: pip install '.[newton]'")

import warp.examples  # noqa: E402

from warp_bounding.newton import ParticleCull, kernels  # noqa: E402

RECORDS = ("particle", "shape", "body_pos", "body_vel", "normal")


@pytest.fixture(scope="module")
def bunny() -> wb.IndicatorMesh:
    return wb.load_indicator(os.path.join(warp.examples.get_asset_directory(), "bunny.usd"))


def records(contacts) -> list[np.ndarray]:
    """Contacts in an order of their own, since that of Newton's pass is by chance on CUDA."""
    count = int(contacts.soft_contact_count.numpy()[0])
    rows = [getattr(contacts, f"soft_contact_{name}").numpy()[:count].copy() for name in RECORDS]
    order = np.lexsort((rows[1], rows[0]))
    return [row[order] for row in rows]


def scene(bunny, device: str, *, particles: int = 3000, ground: bool = True):
    """Two bunnies, one with a bounder of distances, one with its box alone, a ground plane, and a state to be moved."""
    builder = newton.ModelBuilder(up_axis=newton.Axis.Y)
    mesh = newton.Mesh(bunny.vertices, bunny.faces.reshape(-1))
    shapes = [
        builder.add_shape_mesh(body=-1, mesh=mesh, xform=wp.transform(wp.vec3(2.5 * i, 0.0, 0.0), wp.quat_identity()))
        for i in range(2)
    ]
    if ground:
        builder.add_ground_plane()
    x = np.random.default_rng(0).uniform([-1.5, -0.1, -1.5], [4.0, 2.0, 1.5], (particles, 3))
    builder.add_particles(x.tolist(), [[0.0] * 3] * particles, [0.01] * particles, [0.02] * particles)
    pipeline = newton.CollisionPipeline(builder.finalize(device=device), soft_contact_gap=0.02)
    far = wb.fit(bunny, "distance", "bvh", leaves=64, device=device)
    return pipeline, {shapes[0]: far}


def expected(pipeline, state) -> list[np.ndarray]:
    contacts = pipeline.contacts()
    pipeline.collide(state, contacts)
    return records(contacts)


def same(a: list[np.ndarray], b: list[np.ndarray]) -> bool:
    return all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


def test_nothing_is_read_back(bunny, device, monkeypatch):
    """Not one array is copied to the host, and nothing waits for the device; survivors keep their order, and a denied pair stands for all others."""
    pipeline, bounders = scene(bunny, device)
    state, contacts = pipeline.model.state(), pipeline.contacts()
    there = expected(pipeline, state)
    cull = ParticleCull(pipeline, bounders, reads_back=False)
    usual = ParticleCull(pipeline, bounders).candidates(state).numpy()

    def refused(*_, **__):
        raise AssertionError("something was read back")

    with monkeypatch.context() as patch:
        for name in ("numpy", "list", "__getitem__", "__array__"):
            patch.setattr(wp.array, name, refused, raising=False)
        for name in ("synchronize", "synchronize_device", "synchronize_stream", "synchronize_event"):
            patch.setattr(wp, name, refused)
        kept = cull.candidates(state)
    cull.collide(state, contacts, candidates=kept)
    assert same(there, records(contacts))
    assert len(kept) == cull.pairs
    pairs, left = kept.numpy(), cull.survivors
    assert len(usual) == left < 0.5 * cull.pairs
    denied = next(pair for pair in pairs if not (usual == pair).all(axis=1).any())
    assert (pairs[(pairs != denied).any(axis=1)] == usual).all()
    assert not (usual == denied).all(axis=1).any()
    assert np.abs(state.particle_q.numpy()[denied[0]] - [2.5 * denied[1], 0.7, 0.0]).max() > 1.0  # a far one


def test_a_graph_holds_the_whole_pass(bunny, device):
    """Captured once, without a pass before it, and launched for other places: contacts are those of all pairs."""
    pipeline, bounders = scene(bunny, device)
    model = pipeline.model
    state, contacts = model.state(), pipeline.contacts()
    rng, first = np.random.default_rng(1), state.particle_q.numpy()
    places = [first + rng.normal(0, 0.2, first.shape).astype(np.float32) for _ in range(3)]
    there = []
    for place in places:
        state.particle_q.assign(place)
        there.append(expected(pipeline, state))
    state.particle_q.assign(first)
    cull = ParticleCull(pipeline, bounders)
    try:
        with wp.ScopedCapture(device) as capture:
            cull.collide(state, contacts)
    except (RuntimeError, TypeError) as error:
        if device != "cpu":
            raise
        pytest.skip(f"this Warp captures no graphs on a CPU: {error}")
    if capture.graph is None:
        pytest.skip("this Warp captures no graphs on a CPU")
    for place, own in zip(places, there, strict=True):
        state.particle_q.assign(place)
        wp.capture_launch(capture.graph)
        assert same(own, records(contacts))
        assert 0 < cull.survivors < 0.5 * cull.pairs
        assert cull.tally()["plane"].culled > 0
    cull.collide(state, contacts)  # and without a graph again
    assert same(there[-1], records(contacts))


def test_all_is_made_before_a_graph_is_captured(bunny, device, monkeypatch):
    """No array is allocated in the first pass: a graph would copy a bounder's numbers from memory that is gone when it is launched."""
    pipeline, bounders = scene(bunny, device)
    state = pipeline.model.state()
    cull = ParticleCull(pipeline, bounders, reads_back=False)
    made, init = [], wp.array.__init__

    def counted(self, *arguments, **options):
        init(self, *arguments, **options)
        if options.get("ptr") is None:  # else it is a view of memory that is there
            made.append(self)

    monkeypatch.setattr(wp.array, "__init__", counted)
    cull.candidates(state)
    assert not made


def test_what_stands_in_for_the_denied_pairs(bunny):
    """One that is far, if there is one; else the first; and nothing where none was denied."""
    pairs = wp.array([[p, 0] for p in range(9)], dtype=wp.vec2i, device="cpu")
    for denied in ([0], [8], [3, 4, 8], list(range(9)), []):
        mask = np.ones(9, np.uint8)
        mask[denied] = 0
        indices, count = wb.compact(wp.array(mask, dtype=wp.uint8, device="cpu"))
        for far in [-1, *denied[-1:]]:
            kept = wp.zeros(9, dtype=wp.vec2i, device="cpu")
            inputs = [pairs, indices, count, wp.array([far], dtype=wp.int32, device="cpu")]
            wp.launch(kernels.gather_or_repeat, 9, inputs, [kept], device="cpu")
            left = [p for p in range(9) if p not in denied]
            other = denied[0] if denied and far < 0 else far
            assert kept.numpy()[:, 0].tolist() == left + [other] * len(denied)
