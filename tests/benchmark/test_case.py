"""Synthetic scenes of the cost benchmark have exactly the requested sizes."""

import pytest
import torch

from rfpp.benchmark.case import Case
from rfpp.errors import UserError


@pytest.mark.parametrize(("triangles", "objects"), [(25_600, 50), (80_000, 156), (1_600, 3), (5, 5), (7, 1)])
def test_scenes_have_the_requested_numbers_of_triangles_and_objects(triangles, objects):
    batch = Case(triangles, objects, views=2, resolution=8, scenes=2).batch(("albedo", "roughness"), seed=0)
    assert batch.scenes.lengths == (objects, objects)
    assert batch.objects.total == len(batch.positions) == 2 * triangles
    assert sum(batch.objects.lengths[:objects]) == triangles
    assert min(batch.objects.lengths) >= 1
    assert batch.gbuffer.shape == (2, 2, 4, 8, 8)
    assert batch.image.shape == (2, 2, 3, 8, 8)


def test_the_seed_determines_the_batch():
    case = Case(triangles=100, objects=5, views=1, resolution=8, scenes=2)
    first, again, other = (case.batch(("albedo",), seed) for seed in (0, 0, 1))
    assert torch.equal(first.positions, again.positions) and torch.equal(first.gbuffer, again.gbuffer)
    assert not torch.equal(first.positions, other.positions)
    assert not torch.equal(first.positions[:100], first.positions[100:])  # the scenes of a batch


@pytest.mark.parametrize("wrong", [{"objects": 101}, {"objects": 0}, {"views": 0}, {"scenes": 0}])
def test_impossible_cases_are_rejected(wrong):
    with pytest.raises(UserError, match="at least"):
        Case(**{"triangles": 100, "objects": 5, "views": 1, "resolution": 8, "scenes": 1, **wrong})
