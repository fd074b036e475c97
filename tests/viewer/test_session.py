"""A session draws what its visitor sees now, and nothing that is over."""

import queue
import threading
from contextlib import contextmanager

import numpy as np
import pytest
from edited_scenes import changed, lamp, scene
from networks import checkpoint_info

from rfpp import Renderer
from rfpp.imaging.tone_maps import SRGB
from rfpp.radiosity.radiosity import Radiosity
from rfpp.scene.packed import pack
from rfpp.scene.spec import Scene
from rfpp.viewer.comparison import Wipe
from rfpp.viewer.edits import moved, replaced
from rfpp.viewer.layers import layers_of
from rfpp.viewer.reference import Reference
from rfpp.viewer.session import Session, View


def view_of(renderer, **changes) -> View:
    made = scene()
    layer = layers_of(renderer)["image"]
    return View(**{"scene": made, "camera": made.cameras[0], "aspect": 1.0, "layer": layer, "tone_map": SRGB(),
                      "longer_side": 16, **changes})  # fmt: skip


@contextmanager
def session(renderer, view, moving_seconds=100.0):
    drawn, complaints = queue.Queue(), queue.Queue()
    made = Session(renderer, threading.Lock(), view, drawn.put, complaints.put, moving_seconds)
    try:
        yield made, drawn, complaints
    finally:
        made.close()
        made._thread.join(10)
        assert not made._thread.is_alive()


def expected(renderer, view, size=(16, 16)):
    return view.tone_map(renderer.render(pack(view.scene).seen_by([view.camera]), size)[0])


def test_the_picture_is_the_renderers_and_follows_each_change(renderer):
    view = view_of(renderer)
    with session(renderer, view) as (visitor, drawn, _):
        first = drawn.get(timeout=30)
        np.testing.assert_array_equal(first.picture, expected(renderer, view))
        visitor.change(camera=view.scene.cameras[1])
        second = drawn.get(timeout=30)
        np.testing.assert_array_equal(second.picture, expected(renderer, visitor.view))
        peak = next(item for item in view.scene.objects if item.name == "peak_1")
        visitor.change(scene=replaced(view.scene, moved(peak, translation=(0.2, 0.0, 0.1))))
        third = drawn.get(timeout=30)
        assert (third.picture != second.picture).any()
    assert drawn.empty()


def test_an_image_in_motion_is_small_and_the_one_at_rest_is_not(renderer):
    view = view_of(renderer, longer_side=96)
    with session(renderer, view, moving_seconds=1e-9) as (visitor, drawn, _):
        assert [drawn.get(timeout=30).rendered for _ in range(2)] == [(64, 64), (96, 96)]
        visitor.change(camera=view.scene.cameras[1])
        assert [drawn.get(timeout=30).rendered for _ in range(2)] == [(64, 64), (96, 96)]


def test_radiosity_is_a_draft_in_motion_and_in_full_at_rest():
    linear = Renderer(Radiosity(), checkpoint_info(resolution=(16, 16)))
    view = view_of(linear)
    with session(linear, view) as (visitor, drawn, _):
        for number, camera in enumerate(view.scene.cameras[:2]):
            if number:
                visitor.change(camera=camera)
            pictures = [drawn.get(timeout=60).picture for _ in range(2)]
            of_camera = pack(view.scene).seen_by([camera])
            draft = linear.render(of_camera, 16, light_samples=1, supersampling=1)[0]
            np.testing.assert_array_equal(pictures[0], view.tone_map(draft))
            np.testing.assert_array_equal(pictures[1], expected(linear, visitor.view))
            assert (pictures[0] != pictures[1]).any()
    assert drawn.empty()


def test_lights_that_change_again_are_drawn_in_full_at_once():
    """By then there is an image of each light."""
    linear = Renderer(Radiosity(), checkpoint_info(resolution=(16, 16)))
    view = view_of(linear, longer_side=96)

    def dimmer(power: float) -> Scene:
        return changed(view.scene, "lamp", material=lamp(power))

    with session(linear, view, moving_seconds=1e-9) as (visitor, drawn, _):
        assert [drawn.get(timeout=60).rendered for _ in range(2)] == [(64, 64), (96, 96)]
        visitor.change(scene=dimmer(2000))
        assert [drawn.get(timeout=60).rendered for _ in range(2)] == [(64, 64), (96, 96)]
        for power in (100, 5000):
            visitor.change(scene=dimmer(power))
            mixed = drawn.get(timeout=60)
            assert mixed.rendered == (96, 96)
            difference = np.abs(mixed.picture.astype(int) - expected(linear, visitor.view, (96, 96)))
            assert difference.max() <= 1
    assert drawn.empty()


def test_views_that_are_over_are_not_drawn(renderer):
    view = view_of(renderer)
    with session(renderer, view) as (visitor, drawn, _):
        drawn.get(timeout=30)
        with visitor._turn:  # someone else is being served meanwhile
            for x in np.linspace(0.1, 1, 50):
                visitor.change(camera=view.camera.model_copy(update={"position": (x, -1.2, 0.8)}))
        pictures = [drawn.get(timeout=30)]
        while len(pictures) < 2:  # one may have been waiting for its turn
            try:
                pictures.append(drawn.get(timeout=1))
            except queue.Empty:
                break
        np.testing.assert_array_equal(pictures[-1].picture, expected(renderer, visitor.view))


def test_what_cannot_be_drawn_is_told_and_the_session_goes_on(renderer):
    view = view_of(renderer)
    peak = next(item for item in view.scene.objects if item.name == "peak_1")
    with session(renderer, view) as (visitor, drawn, complaints):
        drawn.get(timeout=30)
        visitor.change(scene=replaced(view.scene, moved(peak, scale=(0.0, 0.0, 0.0))))
        assert "peak_1" in complaints.get(timeout=30)
        visitor.change(scene=view.scene)
        np.testing.assert_array_equal(drawn.get(timeout=30).picture, expected(renderer, view))


def test_a_reference_is_compared_only_where_it_shows_this_view(renderer):
    view = view_of(renderer)
    white = Reference(np.ones((16, 16, 3), np.float32), 1.0, view.scene, view.camera)
    with session(renderer, view) as (visitor, drawn, _):
        drawn.get(timeout=30)
        visitor.change(reference=white, comparison=Wipe(), share=0.25)
        compared = drawn.get(timeout=30)
        assert compared.compared and (compared.picture[:, 5:] == 255).all()
        np.testing.assert_array_equal(compared.picture[:, :4], expected(renderer, view)[:, :4])
        visitor.change(camera=view.scene.cameras[1])
        assert not drawn.get(timeout=30).compared


@pytest.mark.parametrize(
    "name", ["light after 0 transports", "normal", "depth", "albedo", "direct diffuse", "position"]
)
def test_everything_that_can_be_shown_is_a_picture(renderer, name):
    view = view_of(renderer)
    packed = pack(view.scene).seen_by([view.camera])
    picture = layers_of(renderer)[name].picture(packed, (16, 24), SRGB())
    assert picture.shape == (16, 24, 3) and picture.dtype == np.uint8
    assert picture.std() > 1


def test_light_after_all_transports_is_the_image(renderer):
    packed = pack(scene()).seen_by(scene().cameras[:1])
    kinds = layers_of(renderer)
    last = f"light after {renderer.engine.iterations} transports"
    np.testing.assert_array_equal(*(kinds[name].picture(packed, (16, 16), SRGB()) for name in ("image", last)))
