"""Caching of objects: an edit encodes the edited objects only, and equals a new renderer bit by bit."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from edited_scenes import added, changed, dimmed, lamp, moved, recolored, removed, reordered, scene
from networks import checkpoint_info, network
from random_scenes import random_views

from rfpp import Renderer
from rfpp.batch import RaggedBatch
from rfpp.inference.object_encoder import ObjectEncoder, object_keys

#: The paper's network, and one that normalizes scenes to their exposure.
NETWORKS = {"paper": (), "exposed": ("experiment=quickstart",)}
CPU = torch.device("cpu")


def renderer(name: str) -> Renderer:
    return Renderer(network(*NETWORKS[name]), checkpoint_info())


def views(seed: int = 0, sizes=(12, 5, 40, 1)):
    return random_views(np.random.default_rng(seed), sizes)


@pytest.mark.parametrize(
    ("edit", "paper", "exposed"),
    [
        # with normalized exposure, a new light changes the emission of both lights
        (moved, 1, 1 + 2),
        (recolored, 1, 1),
        (dimmed, 1, 2),
        (added, 1, 1 + 2),
        (removed, 0, 2),
        (reordered, 0, 0),
    ],
)
def test_an_edit_encodes_changed_objects_and_is_exact(edit, paper, exposed):
    for name, expected in (("paper", paper), ("exposed", exposed)):
        warm = renderer(name)
        before = warm.render(scene())
        known = warm.engine.objects.encoded
        assert known == len(scene().objects)
        after = warm.render(edit(scene()))
        assert warm.engine.objects.encoded - known == expected, name
        np.testing.assert_array_equal(after, renderer(name).render(edit(scene())))
        np.testing.assert_array_equal(warm.render(scene()), before)  # and back
        if edit is not reordered:
            assert np.abs(after - before).max() > 1e-6 * before.max()


def test_scaling_all_lights_encodes_nothing_with_normalized_exposure():
    warm = renderer("exposed")
    before = warm.render(scene())
    known = warm.engine.objects.encoded
    half = changed(changed(scene(), "lamp", material=lamp(1500)), "spot", material=lamp(350))
    np.testing.assert_allclose(warm.render(half), before / 2, rtol=1e-4, atol=1e-6 * before.max())
    assert warm.engine.objects.encoded == known


@pytest.mark.parametrize("part", ["positions", "normals", "material"])
def test_keys_depend_on_all_properties_of_an_object(part):
    original = views()
    array = getattr(original.triangles, part).copy()
    array[12] += 0.01  # the second object's first triangle
    edited = replace(original, triangles=replace(original.triangles, **{part: array}))
    before, after = (object_keys(RaggedBatch.pack([v])) for v in (original, edited))
    assert [a == b for a, b in zip(before, after, strict=True)] == [True, False, True, True]


def test_keys_depend_on_textures():
    texture = np.zeros((58, 13, 4, 4), np.float32)
    painted = texture.copy()
    painted[-1, 0, 2, 1] = 0.5
    keys = [object_keys(RaggedBatch.pack([replace(views(), texture=t)])) for t in (None, texture, painted)]
    assert not set(keys[0]) & set(keys[1])
    assert [a == b for a, b in zip(*keys[1:], strict=True)] == [True, True, True, False]


@torch.inference_mode()
def test_chunks_change_tokens_by_rounding_only():
    net, batch = network(), RaggedBatch.pack([views()])
    _, whole = net.tokenize(batch)
    for at_once in (1, 20, 10**6):
        _, tokens = ObjectEncoder(net, CPU, triangles_at_once=at_once).tokenize(batch)
        torch.testing.assert_close(tokens.features, whole.features, rtol=1e-5, atol=1e-5)
        torch.testing.assert_close(tokens.points, whole.points)
        torch.testing.assert_close(tokens.log_emission, whole.log_emission)
        assert tokens.segments.lengths == whole.segments.lengths


@torch.inference_mode()
def test_tokens_of_an_object_do_not_depend_on_other_objects():
    net = network()
    original = views(sizes=(3, 33, 64, 1, 17))
    offsets = original.triangles.object_offsets
    tokens = ObjectEncoder(net, CPU).tokenize(RaggedBatch.pack([original]))[1].features.chunk(5)
    for number in range(5):
        rows = slice(offsets[number], offsets[number + 1])
        triangles = original.triangles
        alone = replace(
            triangles,
            **{part: getattr(triangles, part)[rows] for part in ("positions", "normals", "material")},
            object_offsets=np.array([0, rows.stop - rows.start], np.int32),
            object_names=("alone",),
        )
        batch = RaggedBatch.pack([replace(original, triangles=alone)])
        assert torch.equal(ObjectEncoder(net, CPU).tokenize(batch)[1].features, tokens[number])
