import builtins
import gc

import numpy as np
import pytest
from known_scenes import sphere, square

from rfpp.errors import MissingDependencyError
from rfpp.raycast.embree import embree
from rfpp.raycast.raycast import RayCaster


def test_barycentric_weights_rebuild_the_hit_point():
    rng = np.random.default_rng(0)
    positions = sphere(0.4).astype(np.float32)
    origins = rng.normal(size=(500, 3)).astype(np.float32)
    origins /= np.linalg.norm(origins, axis=1, keepdims=True)
    directions = (rng.uniform(-0.3, 0.3, (500, 3)) - origins).astype(np.float32)
    hits = RayCaster(positions).cast(origins, directions)
    hit = hits.triangle >= 0
    assert hit.sum() > 400
    by_weights = np.einsum("rc,rcx->rx", hits.barycentric[hit], positions[hits.triangle[hit]])
    by_distance = (origins + hits.distance[:, None] * directions)[hit]
    np.testing.assert_allclose(by_weights, by_distance, atol=1e-5)
    np.testing.assert_allclose(hits.barycentric[hit].sum(1), 1, atol=1e-6)


def test_the_nearest_triangle_wins_and_both_sides_count():
    caster = RayCaster(np.concatenate([square(z=0), square(z=1), square(z=2)]).astype(np.float32))
    origins = np.array([[0.1, 0.2, 3], [0.1, 0.2, -1], [0.1, 0.2, 1.5], [5, 5, 3]], np.float32)
    directions = np.array([[0, 0, -2], [0, 0, 1], [0, 0, -1], [0, 0, -1]], np.float32)
    hits = caster.cast(origins, directions)
    assert (hits.triangle[:3] // 2).tolist() == [2, 0, 1]
    np.testing.assert_allclose(hits.distance, [0.5, 1, 0.5, np.inf])
    assert hits.triangle[3] == -1 and not hits.barycentric[3].any()


def test_no_triangles_and_no_rays():
    empty, rays = RayCaster(np.zeros((0, 3, 3), np.float32)), np.ones((3, 3), np.float32)
    assert empty.cast(rays, rays).triangle.tolist() == [-1, -1, -1]
    none = np.zeros((0, 3), np.float32)
    assert len(RayCaster(square().astype(np.float32)).cast(none, none).triangle) == 0


def test_the_caster_keeps_its_own_copy_of_the_geometry():
    positions = square().astype(np.float32)
    caster = RayCaster(positions)
    positions += 100
    del positions
    gc.collect()
    hits = caster.cast(np.array([[0.1, 0, 1]], np.float32), np.array([[0, 0, -1]], np.float32))
    assert hits.distance[0] == pytest.approx(1, abs=1e-6)


def test_missing_embree_says_how_to_install_it(monkeypatch):
    original = builtins.__import__

    def without_embree(name, *args, **kwargs):
        if name.startswith("embreex"):
            raise ImportError(f"No module named '{name}'")
        return original(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without_embree)
    embree.cache_clear()
    with pytest.raises(MissingDependencyError, match="pip install embreex"):
        RayCaster(square().astype(np.float32))
