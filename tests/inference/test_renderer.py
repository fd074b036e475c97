"""Rendering scenes through the public API, with an untrained network."""

import numpy as np
import pytest
from networks import checkpoint_info, network
from small_data import BoxFamily

from rfpp import Renderer
from rfpp.errors import SceneError, UserError
from rfpp.scene.spec import Camera


@pytest.fixture(scope="module")
def renderer():
    return Renderer(network(), checkpoint_info())


@pytest.fixture(scope="module")
def scene():
    return BoxFamily(views=3).sample(np.random.default_rng(0), np.random.default_rng(1), held_out=False)


def test_every_camera_gets_a_finite_non_negative_image(renderer, scene):
    images = renderer.render(scene)
    assert images.shape == (3, 16, 16, 3)
    assert np.isfinite(images).all()
    assert (images >= 0).all()
    assert images.std() > 0


def test_any_resolution_that_divides_into_patches(renderer, scene):
    assert renderer.render(scene, 24).shape == (3, 24, 24, 3)
    assert renderer.render(scene, (8, 20)).shape == (3, 8, 20, 3)
    with pytest.raises(UserError, match="30 x 30 does not divide into patches of 4"):
        renderer.render(scene, 30)


def test_views_are_independent_of_each_other(renderer, scene):
    together = renderer.render(scene)
    alone = renderer.render(scene, cameras=scene.cameras[2:])
    np.testing.assert_allclose(together[2], alone[0], rtol=1e-4, atol=1e-5)


def test_other_cameras_than_the_scenes_own(renderer, scene):
    camera = Camera(position=(0, -1.5, 0.5), look_at=(0, 0, 0), fov=40)
    assert renderer.render(scene, cameras=[camera]).shape == (1, 16, 16, 3)


def test_the_scene_is_encoded_once(renderer, scene, monkeypatch):
    calls = []
    encode = renderer.network.encode
    monkeypatch.setattr(renderer.network, "encode", lambda batch: calls.append(1) or encode(batch))
    renderer.render(scene)
    assert calls == [1]


def test_a_scene_without_cameras_is_refused_by_name(renderer, scene):
    with pytest.raises(SceneError, match="scene 'boxes' has no camera"):
        renderer.render(scene.model_copy(update={"cameras": ()}))
