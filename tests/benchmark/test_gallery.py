"""The gallery: a row and a line of pictures for each scene."""

import numpy as np
import pytest
from edited_scenes import scene
from marks import requires_blender
from networks import checkpoint_info, network
from PIL import Image
from small_data import REFERENCE, BoxFamily

from rfpp.benchmark import gallery
from rfpp.benchmark.equal_time import errors
from rfpp.benchmark.exhibits import SampledScene, SceneFile
from rfpp.benchmark.gallery import in_the_time, measure
from rfpp.commands import CONFIG_DIR
from rfpp.errors import UserError
from rfpp.inference.renderer import Renderer
from rfpp.reference.cycles import CyclesSettings
from rfpp.scene.io.saving import save_scene


@pytest.fixture
def scene_file(tmp_path):
    return save_scene(scene(), tmp_path / "six.json")


def test_exhibits_are_seen_by_one_camera_and_may_be_moved(scene_file):
    still = SceneFile("still", scene_file, camera=1).scene()
    assert still.c2w.shape == (1, 4, 4)
    name = scene().objects[1].name
    away = SceneFile("moved", scene_file, camera=1, moved={name: (0.3, 0.2, 0.1)}).scene()
    rows = still.triangles.object_index == 1
    shift = away.triangles.positions - still.triangles.positions
    assert np.abs(shift[rows][0, 0]).max() > 0.01
    np.testing.assert_allclose(shift[rows], np.broadcast_to(shift[rows][0, 0], shift[rows].shape), atol=1e-6)
    np.testing.assert_array_equal(shift[~rows], 0)
    with pytest.raises(UserError, match="has no object 'ghost'"):
        SceneFile("ghost", scene_file, moved={"ghost": (0, 0, 0)}).scene()


def test_drawn_exhibits_are_the_same_every_time():
    one, two, other = (SampledScene("drawn", BoxFamily(), seed).scene() for seed in (3, 3, 4))
    np.testing.assert_array_equal(one.triangles.positions, two.triangles.positions)
    assert not np.array_equal(one.triangles.positions, other.triangles.positions)


@pytest.mark.parametrize("path", sorted((CONFIG_DIR.parent / "data/scenes").glob("*.json")), ids=lambda path: path.stem)
def test_shipped_scenes_keep_to_the_box(path):
    triangles = SceneFile("shipped", path).scene().triangles
    assert triangles.is_emissive.any()
    assert np.abs(triangles.positions[~triangles.is_emissive]).max() <= 0.5 + 1e-6


def test_the_rival_has_the_most_samples_that_take_no_longer():
    seconds = {4: 0.4, 1: 0.2, 2: 0.3, 8: 0.6}
    assert in_the_time(seconds, 0.5) == 4
    assert in_the_time(seconds, 0.6) == 8
    assert in_the_time(seconds, 9.0) == 8
    assert in_the_time({**seconds, 2: 0.7}, 0.5) == 4  # whatever fewer samples take
    assert in_the_time(seconds, 0.1) == 1


def untrained(folder):
    """A network's folder."""
    return str(Renderer(network(), checkpoint_info()).save(folder))


def test_each_scene_has_the_rival_of_its_own_time(scene_file, tmp_path, monkeypatch):
    exhibits = [SceneFile("six", scene_file), SampledScene("drawn", BoxFamily(), 0)]
    slow, images = len(exhibits[0].scene().triangles), {}

    def traced(scenes, size, settings):
        """As bright as it has samples; four take long in the first scene."""
        images[settings.samples] = np.full((*size, 3), settings.samples / 8, np.float32)
        for one in scenes:
            yield images[settings.samples][None], 1e6 * (settings.samples == 4 and len(one.triangles) == slow)

    monkeypatch.setattr(gallery, "path_traced", traced)
    picture, settings = tmp_path / "g.png", (REFERENCE, REFERENCE)
    measured = measure(untrained(tmp_path / "net"), exhibits, 16, *settings, [1, 2, 4], picture, lambda *_: None)
    rows = list(measured)
    assert [row["rival_samples"] for row in rows] == [2, 4]
    for row in rows:
        expected = errors(images[row["rival_samples"]], images[REFERENCE.samples])
        assert {name: row[f"rival_{name}"] for name in expected} == expected
        assert row["rival_s"] <= row["network_s"]


@requires_blender
def test_a_row_and_a_line_of_pictures_for_each(scene_file, tmp_path):
    settings = CyclesSettings(
        samples=4, adaptive_threshold=0.0, denoise=False, max_bounces=2, diffuse_bounces=2, glossy_bounces=2,
        clamp_direct=0.0, clamp_indirect=10.0, caustics=True, blur_glossy=1.0, light_threshold=0.01, filter_width=1.5,
        seed=0, threads=1,
    )  # fmt: skip
    made = []
    exhibits = [SceneFile("six", scene_file), SampledScene("drawn", BoxFamily(), 0)]
    folder, picture = untrained(tmp_path / "net"), tmp_path / "g.png"
    measured = measure(folder, exhibits, 16, settings, settings, [1, 2], picture, lambda *turn: made.append(turn))
    rows = list(measured)
    assert made == [(2, 8), (4, 8), (6, 8), (7, 8), (8, 8)]
    assert [row["scene"] for row in rows] == ["six", "drawn"]
    assert all(row["network_s"] > 0 and row["cycles_s"] > 0 and 0 < row["flip"] <= 1 for row in rows)
    for row in rows:
        assert row["rival_samples"] == 1 or row["rival_s"] <= row["network_s"]
        assert row["rival_samples"] in (1, 2)
        assert 0 < row["rival_log_l1"] < row["log_l1"]  # few samples are nearer than a network that was not trained
        assert 0 < row["rival_flip"] < row["flip"]
    sheet = np.asarray(Image.open(tmp_path / "g.png"))
    assert sheet.shape[0] > 2 * 160 and sheet.shape[1] > 5 * 160
