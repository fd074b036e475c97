"""Rendering with a network that refines its images."""

import numpy as np
import pytest
import torch
from edited_scenes import changed, dimmed, lamp, scene
from networks import checkpoint_info, model_config, network

from rfpp import Renderer
from rfpp.inference.light_mixing import LightMixer
from rfpp.radiosity.refinement import Refinement
from rfpp.scene.packed import pack

SIZE = (16, 16)
LINEAR, PAPER = "experiment=quickstart", "experiment=large_scale"
REFINEMENT = {"_target_": "rfpp.radiosity.refinement.Refinement", "widths": [8, 12, 16], "bound": 1.0}


def refined_network(overrides: str = LINEAR):
    net = network(overrides)
    torch.manual_seed(0)
    net.refinement = Refinement(REFINEMENT["widths"], REFINEMENT["bound"])
    torch.nn.init.normal_(net.refinement.out.weight)
    return net.eval()


def renderer(overrides: str = LINEAR) -> Renderer:
    return Renderer(refined_network(overrides), checkpoint_info(resolution=SIZE))


def unrefined(overrides: str = LINEAR) -> Renderer:
    return Renderer(network(overrides), checkpoint_info(resolution=SIZE))


@pytest.mark.parametrize("overrides", [LINEAR, PAPER], ids=["linear light", "the paper's"])
def test_refined_images_are_those_of_the_network_before_refined(overrides):
    ours, before = renderer(overrides), unrefined(overrides).render(scene())
    images = ours.render(scene())
    assert not np.allclose(images, before, rtol=0.05)
    np.testing.assert_array_equal(np.stack(list(ours.views(scene(), refined=False))), before)
    np.testing.assert_allclose(ours.refined(before, pack(scene())), images, rtol=1e-4, atol=1e-6)


def test_the_sum_of_the_lights_refined_is_the_image():
    ours = renderer()
    apart = ours.render_lights(scene())
    np.testing.assert_allclose(
        ours.refined(sum(apart.values()), pack(scene())), ours.render(scene()), rtol=1e-3, atol=1e-5
    )
    np.testing.assert_allclose(sum(apart.values()), unrefined().render(scene()), rtol=1e-4, atol=1e-6)


def test_the_sum_of_the_bounces_is_the_image_before():
    np.testing.assert_allclose(
        renderer().render_bounces(scene()).sum(0), unrefined().render(scene()), rtol=1e-4, atol=1e-5
    )


def test_mixed_lights_are_a_fresh_render():
    mixer, one = LightMixer(renderer()), pack(scene()).views([0])
    mixer.image(one, SIZE)
    for power in (100, 9000):
        brighter = pack(changed(scene(), "lamp", material=lamp(power))).views([0])
        fresh = renderer().render(brighter)[0]
        np.testing.assert_allclose(mixer.image(brighter, SIZE), fresh, rtol=2e-3, atol=1e-4 * fresh.max())
        assert mixer.ready(brighter, SIZE)


def test_twice_the_power_is_twice_the_image_and_an_edited_scene_is_as_a_new_one():
    ours = renderer()
    once = ours.render(scene())
    np.testing.assert_array_equal(ours.render(dimmed(scene())), renderer().render(dimmed(scene())))
    powered = changed(changed(scene(), "lamp", material=lamp(6000)), "spot", material=lamp(1400))
    np.testing.assert_allclose(ours.render(powered), 2 * once, rtol=1e-3, atol=1e-5)


def test_a_refined_network_is_saved_and_loaded(tmp_path):
    info = checkpoint_info(model_config(LINEAR) | {"refinement": REFINEMENT}, resolution=SIZE)
    saved = Renderer(refined_network(), info).save(tmp_path / "refined")
    loaded = Renderer.load(saved, precision="fp32")
    np.testing.assert_array_equal(loaded.render(scene()), renderer().render(scene()))
