"""Rendering with radiosity: lights and bounces apart, edits, and the refinement."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
from edited_scenes import changed, dimmed, lamp, moved, reordered, scene, with_objects
from networks import checkpoint_info, network

import rfpp.inference.radiosity_source
from rfpp import Renderer, Scene
from rfpp.errors import UserError
from rfpp.inference.light_mixing import LightMixer
from rfpp.radiosity.radiosity import Radiosity
from rfpp.radiosity.refinement import Refinement
from rfpp.scene.packed import pack

SIZE = (16, 16)
WIDTHS = [8, 12, 16]


def renderer() -> Renderer:
    """Radiosity without refinement."""
    return Renderer(Radiosity(), checkpoint_info(resolution=SIZE))


def refining() -> Renderer:
    """Radiosity with a refinement of random weights."""
    torch.manual_seed(0)
    refinement = Refinement(WIDTHS, bound=1.0)
    torch.nn.init.normal_(refinement.out.weight)
    part = {"_target_": "rfpp.radiosity.refinement.Refinement", "widths": WIDTHS, "bound": 1.0}
    model = {"_target_": "rfpp.radiosity.radiosity.Radiosity", "refinement": part}
    return Renderer(Radiosity(refinement), checkpoint_info(model, resolution=SIZE))


def with_power(factor: float) -> Scene:
    return changed(changed(scene(), "lamp", material=lamp(factor * 3000)), "spot", material=lamp(factor * 700))


@pytest.mark.parametrize("make", [renderer, refining])
def test_twice_the_power_is_twice_the_image(make):
    ours = make()
    once, twice = ours.render(with_power(1.0)), ours.render(with_power(2.0))
    assert once.max() > 0
    np.testing.assert_allclose(twice, 2 * once, rtol=1e-3, atol=1e-5)
    assert not ours.render(with_power(0.0)).any()


@pytest.mark.parametrize("edit", [dimmed, moved, reordered], ids=lambda edit: edit.__name__)
def test_an_edited_scene_renders_as_with_a_new_renderer(edit):
    edited, ours = edit(scene()), refining()
    ours.render(scene())
    np.testing.assert_array_equal(ours.render(edited), refining().render(edited))


def test_dimming_a_light_reuses_the_cells(monkeypatch):
    found, real = [], rfpp.inference.radiosity_source.find_places
    monkeypatch.setattr(rfpp.inference.radiosity_source, "find_places", lambda *args: found.append(1) or real(*args))
    ours = renderer()
    for each in (scene(), dimmed(scene()), moved(scene())):
        ours.render(each)
    assert len(found) == 2


def test_more_bounces_are_more_light():
    images = [renderer().render(scene(), transports=count) for count in (0, 1, None)]
    assert all((b >= a - 1e-6).all() for a, b in pairwise(images))
    assert images[1].sum() > images[0].sum()


class TestLightsApart:
    @pytest.fixture(scope="class")
    def apart(self):
        return renderer().render_lights(scene(), light_samples=4)

    def test_their_sum_is_the_image(self, apart):
        assert list(apart) == ["lamp", "spot"]
        assert all(images.max() > 0 for images in apart.values())
        whole = renderer().render(scene(), light_samples=4)
        np.testing.assert_allclose(sum(apart.values()), whole, rtol=1e-4, atol=1e-6)

    def test_a_weighted_sum_is_the_image_of_dimmed_and_colored_lights(self, apart):
        blue = lamp(700).model_copy(update={"emissive": (140.0, 700.0, 1400.0)})
        both = changed(changed(scene(), "lamp", material=lamp(1500)), "spot", material=blue)
        mixed = 0.5 * apart["lamp"] + np.array([0.2, 1.0, 2.0]) * apart["spot"]
        np.testing.assert_allclose(mixed, renderer().render(both, light_samples=4), rtol=1e-3, atol=1e-5)


class TestBouncesApart:
    @pytest.fixture(scope="class")
    def apart(self):
        return renderer().render_bounces(scene(), light_samples=4)

    def test_their_sum_is_the_image(self, apart):
        assert len(apart) > 3
        assert (apart >= 0).all()
        np.testing.assert_allclose(apart.sum(0), renderer().render(scene(), light_samples=4), rtol=1e-4, atol=1e-6)

    @pytest.mark.parametrize("transports", [0, 3])
    def test_the_first_are_the_image_of_fewer_bounces(self, apart, transports):
        fewer = renderer().render_bounces(scene(), light_samples=4, transports=transports)
        np.testing.assert_allclose(fewer, apart[: 2 + transports], rtol=1e-4, atol=1e-6)
        image = renderer().render(scene(), light_samples=4, transports=transports)
        np.testing.assert_allclose(fewer.sum(0), image, rtol=1e-4, atol=1e-6)

    def test_a_floor_alone_has_little_but_direct_light(self, apart):
        alone = with_objects(scene(), [o for o in scene().objects if not o.name.startswith("peak")])
        first, *others = renderer().render_bounces(alone, light_samples=4)
        np.testing.assert_allclose(first, renderer().render(alone, light_samples=4), rtol=1e-2)
        assert 0 < np.max(others) < 0.01 * first.max()  # lamps reflect a little
        assert apart[1].max() > 0.05 * apart[0].max()


def test_lights_and_bounces_of_a_file_add_up():
    file = Path(__file__).parents[2] / "data/scenes/cornell_box.json"
    whole, lights = renderer().render(file, 16), renderer().render_lights(f"{file}", 16)
    np.testing.assert_allclose(sum(lights.values()), whole, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(renderer().render_bounces(file, 16).sum(0), whole, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("parts", ["lights", "bounces"])
def test_networks_cannot_render_parts(parts):
    with pytest.raises(UserError, match=f"{parts}: this network's image is not a sum"):
        getattr(Renderer(network(), checkpoint_info()), f"render_{parts}")(scene())


class TestRefinement:
    def test_it_applies_to_finished_images(self):
        ours, before = refining(), renderer().render(scene())
        images = ours.render(scene())
        assert not np.allclose(images, before, rtol=0.05)
        np.testing.assert_array_equal(np.stack(list(ours.views(scene(), is_refined=False))), before)
        np.testing.assert_allclose(ours.refined(before, pack(scene())), images, rtol=1e-4, atol=1e-6)

    def test_the_refined_sum_of_the_lights_is_the_image(self):
        ours = refining()
        apart = ours.render_lights(scene())
        refined = ours.refined(sum(apart.values()), pack(scene()))
        np.testing.assert_allclose(refined, ours.render(scene()), rtol=1e-3, atol=1e-5)
        np.testing.assert_allclose(sum(apart.values()), renderer().render(scene()), rtol=1e-4, atol=1e-6)

    def test_mixed_lights_are_refined(self):
        mixer = LightMixer(refining())
        for power in (3000, 4500, 6000):
            brighter = pack(changed(scene(), "lamp", material=lamp(power))).views([0])
            fresh = refining().render(brighter)[0]
            np.testing.assert_allclose(mixer.image(brighter, SIZE), fresh, rtol=2e-3, atol=1e-4 * fresh.max())
        assert mixer.is_separated(brighter, SIZE)

    def test_it_is_saved_and_loaded(self, tmp_path):
        loaded = Renderer.load(refining().save(tmp_path / "refined"), precision="fp32")
        np.testing.assert_array_equal(loaded.render(scene()), refining().render(scene()))
