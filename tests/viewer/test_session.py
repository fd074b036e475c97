"""A session draws the newest view of its visitor, and skips outdated ones."""

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
from rfpp.viewer.edits import with_object, with_transform
from rfpp.viewer.layers import layers_of
from rfpp.viewer.pacing import Pacing
from rfpp.viewer.session import Reference, Session, View


def view_of(renderer, longer_side=16) -> View:
    return View(scene(), scene().cameras[0], 1.0, layers_of(renderer)["image"], SRGB(), longer_side)


@contextmanager
def session(renderer, view, moving_seconds=100.0):
    drawn, reports = queue.Queue(), queue.Queue()
    pacing = Pacing(renderer.engine.patch_size, moving_seconds)
    started = Session(view, pacing, threading.Lock(), reports.put)
    started.on_draw(drawn.put)
    started.start()
    try:
        yield started, drawn, reports
    finally:
        started.close()
        started._thread.join(10)
        assert not started._thread.is_alive()


def expected(renderer, view, size=(16, 16)):
    return view.tone_map(renderer.render(pack(view.scene).seen_by([view.camera]), size)[0])


@pytest.fixture
def radiosity():
    return Renderer(Radiosity(), checkpoint_info(resolution=(16, 16)))


def test_pictures_equal_the_renderers_and_follow_each_change(renderer):
    view = view_of(renderer)
    with session(renderer, view) as (visitor, drawn, _):
        np.testing.assert_array_equal(drawn.get(timeout=30).picture, expected(renderer, view))
        visitor.change(camera=view.scene.cameras[1])
        second = drawn.get(timeout=30)
        np.testing.assert_array_equal(second.picture, expected(renderer, visitor.view))
        peak = next(item for item in view.scene.objects if item.name == "peak_1")
        visitor.change(scene=with_object(view.scene, with_transform(peak, translation=(0.2, 0.0, 0.1))))
        third = drawn.get(timeout=30)
        np.testing.assert_array_equal(third.picture, expected(renderer, visitor.view))
        assert (third.picture != second.picture).any()
    assert drawn.empty()


def test_images_in_motion_are_small(renderer):
    view = view_of(renderer, longer_side=96)
    with session(renderer, view, moving_seconds=1e-9) as (visitor, drawn, _):
        assert [drawn.get(timeout=30).rendered for _ in range(2)] == [(64, 64), (96, 96)]
        visitor.change(camera=view.scene.cameras[1])
        assert [drawn.get(timeout=30).rendered for _ in range(2)] == [(64, 64), (96, 96)]


def test_radiosity_draws_drafts_in_motion(radiosity):
    view = view_of(radiosity)
    with session(radiosity, view) as (visitor, drawn, _):
        for number, camera in enumerate(view.scene.cameras[:2]):
            if number:
                visitor.change(camera=camera)
            pictures = [drawn.get(timeout=60).picture for _ in range(2)]
            draft = radiosity.render(pack(view.scene).seen_by([camera]), 16, light_samples=1, supersampling=1)[0]
            np.testing.assert_array_equal(pictures[0], view.tone_map(draft))
            np.testing.assert_array_equal(pictures[1], expected(radiosity, visitor.view))
            assert (pictures[0] != pictures[1]).any()
    assert drawn.empty()


def test_separated_lights_are_drawn_in_full_at_once(radiosity):
    view = view_of(radiosity, longer_side=96)
    with session(radiosity, view, moving_seconds=1e-9) as (visitor, drawn, _):
        assert [drawn.get(timeout=60).rendered for _ in range(2)] == [(64, 64), (96, 96)]
        visitor.change(scene=changed(view.scene, "lamp", material=lamp(2000)))
        assert [drawn.get(timeout=60).rendered for _ in range(2)] == [(64, 64), (96, 96)]
        for power in (100, 5000):
            visitor.change(scene=changed(view.scene, "lamp", material=lamp(power)))
            mixed = drawn.get(timeout=60)
            assert mixed.rendered == (96, 96)
            assert np.abs(mixed.picture.astype(int) - expected(radiosity, visitor.view, (96, 96))).max() <= 1
    assert drawn.empty()


def test_outdated_views_are_skipped(renderer):
    view = view_of(renderer)
    with session(renderer, view) as (visitor, drawn, _):
        drawn.get(timeout=30)
        with visitor._lock:  # another visitor's picture is being rendered
            for x in np.linspace(0.1, 1, 50):
                visitor.change(camera=view.camera.model_copy(update={"position": (x, -1.2, 0.8)}))
        pictures = [drawn.get(timeout=30)]
        while len(pictures) < 2:  # one view may have been waiting for the lock
            try:
                pictures.append(drawn.get(timeout=1))
            except queue.Empty:
                break
        np.testing.assert_array_equal(pictures[-1].picture, expected(renderer, visitor.view))
        assert drawn.empty()


def test_errors_are_reported_and_the_session_continues(renderer):
    view = view_of(renderer)
    peak = next(item for item in view.scene.objects if item.name == "peak_1")
    with session(renderer, view) as (visitor, drawn, reports):
        drawn.get(timeout=30)
        visitor.change(scene=with_object(view.scene, with_transform(peak, scale=(0.0, 0.0, 0.0))))
        assert "peak_1" in reports.get(timeout=30)
        visitor.change(scene=view.scene)
        np.testing.assert_array_equal(drawn.get(timeout=30).picture, expected(renderer, view))


def test_a_reference_is_shown_beside_its_own_view_only(renderer):
    view = view_of(renderer)
    white = Reference(np.ones((16, 16, 3), np.float32), 1.0, view.scene, view.camera)
    with session(renderer, view) as (visitor, drawn, _):
        drawn.get(timeout=30)
        visitor.change(reference=white, share=0.25)
        compared = drawn.get(timeout=30)
        assert compared.is_compared and (compared.picture[:, 4:] == 255).all()
        np.testing.assert_array_equal(compared.picture[:, :4], expected(renderer, view)[:, :4])
        for change in ({"share": 1.0}, {"share": 0.25, "camera": view.scene.cameras[1]}):
            visitor.change(**change)
            alone = drawn.get(timeout=30)
            np.testing.assert_array_equal(alone.picture, expected(renderer, visitor.view))
            assert not alone.is_compared


@pytest.mark.parametrize(
    "name", ["light after 0 transports", "normal", "depth", "albedo", "direct diffuse", "position"]
)
def test_every_layer_is_a_picture(renderer, name):
    view = view_of(renderer)
    picture = layers_of(renderer)[name].picture(pack(view.scene).seen_by([view.camera]), (16, 24), SRGB())
    assert picture.shape == (16, 24, 3) and picture.dtype == np.uint8
    assert picture.std() > 1
