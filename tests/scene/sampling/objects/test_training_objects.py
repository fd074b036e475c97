"""Test scenes of objects that training has seen."""

import dataclasses

import numpy as np
import pytest
from scene_families import family, objects

from rfpp.scene.sampling.objects.object_source import ObjectSource
from rfpp.scene.sampling.objects.training_objects import TrainingObjects

HELD_OUT = family("quickstart", "family.objects.pool=20", "family.objects.held_out=0.5")
SEEN = dataclasses.replace(HELD_OUT, objects=TrainingObjects(HELD_OUT.objects))


def drawn(of, seed, held_out):
    return of.sample(*(np.random.default_rng([seed, stream]) for stream in range(2)), held_out=held_out)


@pytest.mark.parametrize("seed", range(4))
def test_a_test_scene_differs_by_its_objects_alone(seed):
    one, other = drawn(HELD_OUT, seed, True), drawn(SEEN, seed, True)
    assert one.cameras == other.cameras
    for kind in ("background", "light"):
        pairs = list(zip(objects(one, kind), objects(other, kind), strict=True))
        assert pairs and all(a.material == b.material and a.transform == b.transform for a, b in pairs)
    pairs = list(zip(objects(one, "object"), objects(other, "object"), strict=True))
    assert all(a.material == b.material for a, b in pairs)
    assert all(not np.array_equal(a.mesh.vertices, b.mesh.vertices) for a, b in pairs)


def test_the_objects_are_those_of_training_scenes():
    there = {item.mesh.vertices.tobytes() for item in objects(drawn(SEEN, 0, True), "object")}
    assert there == {item.mesh.vertices.tobytes() for item in objects(drawn(HELD_OUT, 0, False), "object")}


def test_it_is_a_source_like_the_others():
    assert isinstance(SEEN.objects, ObjectSource) and SEEN.objects.libraries() == ()
    account = SEEN.objects.account({"source": {"pool": 20}})
    assert account == {"held_out": "none", "source": {"pool": 20}}
