"""Rendering with networks whose light comes from cells: the same scene lit otherwise, and edited."""

from itertools import pairwise

import numpy as np
import pytest
from edited_scenes import changed, dimmed, lamp, moved, reordered, scene, with_objects
from networks import checkpoint_info, network

from rfpp import Renderer, Scene
from rfpp.errors import UserError

LINEAR = ("experiment=quickstart",)
EDITS = (dimmed, moved, reordered)


def renderer(*overrides: str) -> Renderer:
    return Renderer(network(*(overrides or LINEAR)), checkpoint_info(resolution=(16, 16)))


def with_power(factor: float) -> Scene:
    return changed(changed(scene(), "lamp", material=lamp(factor * 3000)), "spot", material=lamp(factor * 700))


def test_twice_the_power_is_twice_the_image():
    ours = renderer()
    once, twice = ours.render(with_power(1.0)), ours.render(with_power(2.0))
    assert once.max() > 0
    np.testing.assert_allclose(twice, 2 * once, rtol=1e-4, atol=1e-6)
    assert not ours.render(with_power(0.0)).any()


@pytest.mark.parametrize("overrides", [LINEAR, ("experiment=[ablation,octant_tokens]",)], ids=["linear", "octants"])
@pytest.mark.parametrize("edit", EDITS, ids=lambda edit: edit.__name__)
def test_an_edited_scene_looks_as_if_it_had_been_so_from_the_start(edit, overrides):
    edited, ours = edit(scene()), renderer(*overrides)
    ours.render(scene())
    np.testing.assert_array_equal(ours.render(edited), renderer(*overrides).render(edited))


def test_more_bounces_are_more_light():
    images = [np.stack(list(renderer().views(scene(), transports=count))) for count in (0, 1, 8)]
    assert all((b >= a - 1e-6).all() for a, b in pairwise(images))
    assert images[1].sum() > images[0].sum()
    np.testing.assert_allclose(images[2], renderer().render(scene()), rtol=1e-5, atol=1e-6)


class TestLightsApart:
    @pytest.fixture(scope="class")
    def apart(self):
        return renderer().render_lights(scene(), light_samples=4)

    def test_their_sum_is_the_image(self, apart):
        assert list(apart) == ["lamp", "spot"]
        assert all(images.max() > 0 for images in apart.values())
        np.testing.assert_allclose(
            sum(apart.values()), renderer().render(scene(), light_samples=4), rtol=1e-4, atol=1e-6
        )

    def test_a_weighted_sum_is_the_image_of_the_lights_dimmed_and_coloured(self, apart):
        blue = lamp(700).model_copy(update={"emissive": (140.0, 700.0, 1400.0)})
        both = changed(changed(scene(), "lamp", material=lamp(1500)), "spot", material=blue)
        mixed = 0.5 * apart["lamp"] + np.array([0.2, 1.0, 2.0]) * apart["spot"]
        np.testing.assert_allclose(mixed, renderer().render(both, light_samples=4), rtol=1e-3, atol=1e-5)

    def test_networks_that_are_not_linear_and_lights_that_are_not_there_are_refused(self):
        other = Renderer(network("experiment=quickstart", "model=known_light"), checkpoint_info(resolution=(16, 16)))
        with pytest.raises(UserError, match="no sum over lights"):
            other.render_lights(scene())
        with pytest.raises(UserError, match="light 'moon' does not exist: choose from lamp, spot"):
            list(renderer().views(scene(), light="moon"))


class TestBouncesApart:
    @pytest.fixture(scope="class")
    def apart(self):
        return renderer().render_bounces(scene(), light_samples=4)

    def test_their_sum_is_the_image(self, apart):
        assert len(apart) == 2 + renderer().network.iterations
        assert (apart >= 0).all()
        np.testing.assert_allclose(apart.sum(0), renderer().render(scene(), light_samples=4), rtol=1e-4, atol=1e-6)

    @pytest.mark.parametrize("transports", [0, 3])
    def test_the_first_are_the_image_of_fewer_transports(self, apart, transports):
        fewer = renderer().render_bounces(scene(), light_samples=4, transports=transports)
        np.testing.assert_allclose(fewer, apart[: 2 + transports], rtol=1e-4, atol=1e-6)
        image = renderer().render(scene(), light_samples=4, transports=transports)
        np.testing.assert_allclose(fewer.sum(0), image, rtol=1e-4, atol=1e-6)

    def test_on_a_lone_floor_there_is_next_to_nothing_but_direct_light(self, apart):
        alone = with_objects(scene(), [o for o in scene().objects if not o.name.startswith("peak")])
        first, *others = renderer().render_bounces(alone, light_samples=4)
        np.testing.assert_allclose(first, renderer().render(alone, light_samples=4), rtol=1e-2)
        assert 0 < np.max(others) < 0.01 * first.max()  # lamps reflect a little
        assert apart[1].max() > 0.05 * apart[0].max()

    def test_networks_that_are_not_linear_are_refused(self):
        other = Renderer(network("experiment=quickstart", "model=known_light"), checkpoint_info(resolution=(16, 16)))
        with pytest.raises(UserError, match="no sum over bounces"):
            other.render_bounces(scene())
