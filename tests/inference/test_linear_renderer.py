"""Rendering with networks whose light comes from cells: the same scene lit otherwise, and edited."""

from itertools import pairwise

import numpy as np
import pytest
from edited_scenes import changed, dimmed, lamp, moved, reordered, scene
from networks import checkpoint_info, network

from rfpp import Renderer, Scene

LINEAR = ("+experiment=quickstart",)
EDITS = (dimmed, moved, reordered)


def renderer() -> Renderer:
    return Renderer(network(*LINEAR), checkpoint_info(resolution=(16, 16)))


def with_power(factor: float) -> Scene:
    return changed(changed(scene(), "lamp", material=lamp(factor * 3000)), "spot", material=lamp(factor * 700))


def test_twice_the_power_is_twice_the_image():
    ours = renderer()
    once, twice = ours.render(with_power(1.0)), ours.render(with_power(2.0))
    assert once.max() > 0
    np.testing.assert_allclose(twice, 2 * once, rtol=1e-4, atol=1e-6)
    assert not ours.render(with_power(0.0)).any()


@pytest.mark.parametrize("edit", EDITS, ids=lambda edit: edit.__name__)
def test_an_edited_scene_looks_as_if_it_had_been_so_from_the_start(edit):
    edited, ours = edit(scene()), renderer()
    ours.render(scene())
    np.testing.assert_array_equal(ours.render(edited), renderer().render(edited))


def test_more_bounces_are_more_light():
    images = [np.stack(list(renderer().views(scene(), transports=count))) for count in (0, 1, 8)]
    assert all((b >= a - 1e-6).all() for a, b in pairwise(images))
    assert images[1].sum() > images[0].sum()
    np.testing.assert_allclose(images[2], renderer().render(scene()), rtol=1e-5, atol=1e-6)
