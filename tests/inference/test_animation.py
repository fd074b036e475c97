"""Animations: frames equal the renderer's images, and only missing or changed frames are rendered."""

import dataclasses

import numpy as np
import pytest
from edited_scenes import dimmed, moved, scene
from networks import checkpoint_info, network

import rfpp.inference.animation
from rfpp import Renderer
from rfpp.errors import UserError
from rfpp.imaging.exr import read_exr
from rfpp.imaging.tone_maps import SRGB
from rfpp.inference.animation import Animation
from rfpp.inference.motion.frames import Frames
from rfpp.reference.cycles import CyclesSettings
from rfpp.scene.packed import pack

SIZE = (16, 24)
CYCLES = CyclesSettings(1, 0.0, False, 1, 1, 1, 0.0, 0.0, True, 0.0, 0.0, 1.5, 0, 0)


@pytest.fixture(scope="module")
def renderer():
    return Renderer(network(), checkpoint_info())


@pytest.fixture
def rendered(renderer, monkeypatch):
    """Number of cameras of each call of the renderer."""
    calls = []
    views = renderer.views

    def counting(scene, *args, **kwargs):
        calls.append(len(scene.fov))
        return views(scene, *args, **kwargs)

    monkeypatch.setattr(renderer, "views", counting)
    return calls


def orbit() -> Frames:
    still = pack(scene())
    return Frames(3, lambda number: still.views([number]))


def edits() -> Frames:
    versions = [scene(), moved(scene()), dimmed(moved(scene()))]
    packed = [pack(version).views([0]) for version in versions]
    return Frames(3, packed.__getitem__)


def make(frames, folder, renderer, light_samples=4, supersampling=2) -> tuple[int, list]:
    """Return the number of rendered frames and the calls of the progress bar."""
    progress = []
    sampling = {"light_samples": light_samples, "supersampling": supersampling}
    made = Animation(frames, folder, SIZE).render(renderer, sampling, lambda *count: progress.append(count))
    return made, progress


def test_frames_equal_the_renderers_images_and_one_scene_is_rendered_at_once(renderer, rendered, tmp_path):
    made, progress = make(orbit(), tmp_path, renderer)
    assert made == 3
    assert rendered == [3]
    assert progress == [(0, 3), (1, 3), (2, 3), (3, 3)]
    expected = renderer.render(pack(scene()), SIZE, light_samples=4)
    for number, image in enumerate(expected):
        stored = read_exr(tmp_path / f"{number:05d}.exr")["RGB"]
        np.testing.assert_array_equal(stored, image.astype(np.float16))


def test_only_animated_objects_are_encoded_again(renderer, tmp_path):
    fresh = renderer.fresh()
    make(edits(), tmp_path, fresh)
    assert fresh.engine.objects.encoded == 6 + 1 + 1  # all; the moved one; the light


def test_existing_frames_are_not_rendered_again(renderer, rendered, tmp_path):
    make(orbit(), tmp_path, renderer)
    times = [file.stat().st_mtime_ns for file in sorted(tmp_path.iterdir())]
    rendered.clear()
    assert make(orbit(), tmp_path, renderer) == (0, [])
    assert rendered == []
    assert [file.stat().st_mtime_ns for file in sorted(tmp_path.iterdir())] == times


def test_missing_damaged_and_changed_frames_are_rendered(renderer, rendered, tmp_path):
    make(orbit(), tmp_path, renderer)
    (tmp_path / "00000.exr").unlink()
    damaged = tmp_path / "00001.exr"
    damaged.write_bytes(damaged.read_bytes()[:-200])
    rendered.clear()
    assert make(orbit(), tmp_path, renderer) == (2, [(0, 3), (1, 3), (2, 3)])
    assert read_exr(damaged)["RGB"].shape == (*SIZE, 3)
    views = [orbit()[0], pack(moved(scene())).views([1]), orbit()[2]]
    assert make(Frames(3, views.__getitem__), tmp_path, renderer) == (1, [(1, 3), (2, 3)])
    assert rendered == [2, 1]


def test_other_settings_and_weights_render_all_frames(renderer, tmp_path):
    make(orbit(), tmp_path, renderer)
    assert make(orbit(), tmp_path, renderer, light_samples=5)[0] == 3
    assert make(orbit(), tmp_path, Renderer(network(seed=1), checkpoint_info()), light_samples=5)[0] == 3
    assert make(orbit(), tmp_path, renderer, light_samples=5, supersampling=3)[0] == 3


def test_frames_before_an_error_are_kept(renderer, tmp_path):
    def create(number):
        if number == 2:
            raise UserError("scene 2: invalid")
        return edits()[number]

    with pytest.raises(UserError, match="scene 2: invalid"):
        make(Frames(3, create), tmp_path, renderer)
    assert make(edits(), tmp_path, renderer)[0] == 2


def test_references_are_resumed_and_compared(renderer, tmp_path, monkeypatch):
    traced = []

    def path_traced(scenes, size, settings):
        for one in scenes:
            traced.append(one)
            yield renderer.render(one, size, light_samples=4), 0.1

    monkeypatch.setattr(rfpp.inference.animation, "path_traced", path_traced)
    animation = Animation(edits(), tmp_path, SIZE)
    animation.render(renderer, {"light_samples": 4, "supersampling": 2}, lambda *_: None)
    progress = []
    assert animation.path_trace(CYCLES, lambda *count: progress.append(count)) == len(traced) == 3
    assert progress[0] == (0, 3) and progress[-1] == (3, 3)
    assert animation.path_trace(CYCLES, lambda *_: None) == 0
    assert animation.path_trace(dataclasses.replace(CYCLES, samples=2), lambda *_: None) == 3

    assert animation.flicker() == 0  # the reference here is the prediction itself
    for picture, both in zip(animation.pictures(SRGB()), animation.comparison(SRGB()), strict=True):
        np.testing.assert_array_equal(both[:, : SIZE[1]], picture)
        np.testing.assert_array_equal(both[:, SIZE[1] : 2 * SIZE[1]], picture)
        assert both.shape == (SIZE[0], 3 * SIZE[1], 3)
        assert both[:, 2 * SIZE[1] :].max() <= 4  # no error
