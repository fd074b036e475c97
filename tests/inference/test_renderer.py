from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from threading import Event
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from networks import checkpoint_info, network
from small_data import BoxFamily

from rfpp import Renderer
from rfpp.batch import RaggedBatch, SceneViews
from rfpp.errors import SceneError, UserError
from rfpp.imaging.radiance import log_decode
from rfpp.inference.network_engine import _computed_ahead
from rfpp.raycast.first_hit import first_hit, stack_channels
from rfpp.scene.io.saving import save_scene
from rfpp.scene.packed import pack


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


def test_scenes_and_their_files_may_be_listed(renderer, scene, tmp_path):
    file, other = save_scene(scene, tmp_path / "scene.json"), scene.model_copy(update={"cameras": scene.cameras[:1]})
    images = renderer.render([file, other])
    assert images.shape == (4, 16, 16, 3)
    np.testing.assert_array_equal(images[3], renderer.render(other)[0])
    np.testing.assert_array_equal(images[:3], renderer.render(str(file)))
    with pytest.raises(SceneError, match="the list of scenes is empty"):
        renderer.render([])


def test_weights_that_are_not_finite_are_an_error(scene):
    diverged = network()
    with torch.no_grad():
        next(diverged.decoder.parameters())[:] = torch.nan
    with pytest.raises(UserError, match=r"view 0: 256 of 256 pixels are not finite: .* training diverged"):
        Renderer(diverged, checkpoint_info()).render(scene)


def test_scenes_that_overflow_are_an_error(scene, monkeypatch):
    bright = Renderer(network(), checkpoint_info())
    overflowing = lambda *args, **others: iter([np.full((16, 16, 3), np.inf, np.float32)])  # noqa: E731
    monkeypatch.setattr(bright.engine, "views", overflowing)
    with pytest.raises(UserError, match=r"pixels are not finite: its lights, sizes"):
        bright.render(scene)


@pytest.mark.parametrize("resolution", [20_000, 1_000_000])
def test_images_larger_than_the_memory_are_refused(renderer, scene, resolution, monkeypatch):
    monkeypatch.setattr("psutil.virtual_memory", lambda: SimpleNamespace(available=2**34))
    with pytest.raises(UserError, match=rf"resolution {resolution} x {resolution}: takes about [\d,]+ GB of memory"):
        renderer.render(scene, resolution)


def test_resolutions_divide_into_patches(renderer, scene):
    assert renderer.render(scene, 24).shape == (3, 24, 24, 3)
    assert renderer.render(scene, (8, 20)).shape == (3, 8, 20, 3)
    with pytest.raises(UserError, match="30 x 30 does not divide into patches of 4"):
        renderer.render(scene, 30)


@pytest.mark.parametrize("none", [{"light_samples": 0}, {"supersampling": 0}])
def test_no_samples_are_refused(renderer, scene, none):
    with pytest.raises(UserError, match="give 1 or more of each"):
        renderer.render(scene, **none)


def test_views_are_independent_of_each_other(renderer, scene):
    together = renderer.render(scene)
    alone = renderer.render(scene, cameras=scene.cameras[2:])
    np.testing.assert_allclose(together[2], alone[0], rtol=1e-4, atol=1e-5)


def test_the_scene_is_encoded_once(renderer, scene, monkeypatch):
    calls = []
    ours = renderer.fresh()
    transported = ours.engine.module.transported
    monkeypatch.setattr(ours.engine.module, "transported", lambda *args: calls.append(1) or transported(*args))
    ours.render(scene)
    ours.render(scene, cameras=scene.cameras[:1])  # another view
    assert calls == [1]
    packed = pack(scene)
    dimmer = replace(packed, triangles=replace(packed.triangles, material=packed.triangles.material * 0.5))
    for wanted in (dimmer, dimmer, scene):
        ours.render(wanted)
    assert calls == [1, 1, 1]  # only the last scene is cached


def test_the_image_equals_the_networks(renderer, scene):
    """The network renders everything in one batch."""
    packed = pack(scene)
    gbuffers = np.stack(
        [
            stack_channels(
                first_hit(packed.triangles, c2w, fov, 16, 16), packed.triangles.material, fov,
                renderer.engine.module.gbuffer_channels,
            )
            for c2w, fov in zip(packed.c2w, packed.fov, strict=True)
        ]
    )  # fmt: skip
    batch = RaggedBatch.pack([SceneViews("together", packed.triangles, packed.c2w, packed.fov, gbuffers)])
    with torch.inference_mode():
        expected = log_decode(renderer.engine.module(batch).log_radiance)[0].permute(0, 2, 3, 1).clamp_min(0).numpy()
    np.testing.assert_allclose(renderer.render(scene), expected, rtol=1e-4, atol=1e-5)


def test_the_next_gbuffer_is_cast_in_the_background():
    begun, seen = [Event() for _ in range(4)], []

    def cast(view: int) -> int:
        begun[view].set()
        return view

    for view in _computed_ahead(cast, 4):
        assert view == 3 or begun[view + 1].wait(timeout=60)
        seen.append(view)
        assert view >= 2 or not begun[view + 2].is_set()  # at most one view ahead
    assert seen == [0, 1, 2, 3]


def test_images_are_yielded_one_by_one(renderer, scene):
    images = renderer.views(scene)
    together = renderer.render(scene)
    for number, image in enumerate(images):
        np.testing.assert_array_equal(image, together[number])
    assert number == 2
    next(renderer.views(scene))  # without consuming all
    assert not torch.is_inference_mode_enabled()


def test_a_renderer_is_shared_by_threads(scene):
    renderer = Renderer(network(), checkpoint_info())
    resolutions = [8, 16, 24, 8]
    with ThreadPoolExecutor(4) as threads:
        images = list(threads.map(lambda resolution: renderer.render(scene, resolution), resolutions))
    for image, resolution in zip(images, resolutions, strict=True):
        np.testing.assert_array_equal(image, renderer.render(scene, resolution))


def test_a_scene_without_cameras_is_refused(renderer, scene):
    with pytest.raises(SceneError, match="scene 'boxes' has no camera"):
        renderer.render(scene.model_copy(update={"cameras": ()}))
