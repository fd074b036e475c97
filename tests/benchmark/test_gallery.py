"""The gallery: a row and a line of pictures for each scene."""

import numpy as np
import pytest
from edited_scenes import scene
from marks import requires_blender
from networks import checkpoint_info, network
from PIL import Image
from small_data import BoxFamily

from rfpp.benchmark.exhibits import SampledScene, SceneFile
from rfpp.benchmark.gallery import measure
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


@requires_blender
def test_a_row_and_a_line_of_pictures_for_each(scene_file, tmp_path):
    Renderer(network(), checkpoint_info()).save(tmp_path / "net")
    settings = CyclesSettings(
        samples=4, adaptive_threshold=0.0, denoise=False, max_bounces=2, diffuse_bounces=2, glossy_bounces=2,
        clamp_direct=0.0, clamp_indirect=10.0, caustics=True, blur_glossy=1.0, light_threshold=0.01, filter_width=1.5,
        seed=0, threads=1,
    )  # fmt: skip
    made = []
    exhibits = [SceneFile("six", scene_file), SampledScene("drawn", BoxFamily(), 0)]
    rows = list(measure(str(tmp_path / "net"), exhibits, 16, settings, tmp_path / "g.png", lambda *n: made.append(n)))
    assert made == [(1, 2), (2, 2)]
    assert [row["scene"] for row in rows] == ["six", "drawn"]
    assert all(row["network_s"] > 0 and row["cycles_s"] > 0 and 0 < row["flip"] <= 1 for row in rows)
    sheet = np.asarray(Image.open(tmp_path / "g.png"))
    assert sheet.shape[0] > 2 * 160 and sheet.shape[1] > 3 * 160
