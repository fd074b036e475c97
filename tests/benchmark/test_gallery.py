import numpy as np
import pytest
from edited_scenes import scene
from marks import requires_blender
from networks import checkpoint_info, network
from PIL import Image
from small_data import REFERENCE, BoxFamily

from rfpp.benchmark import methods
from rfpp.benchmark.gallery import affordable, measure
from rfpp.benchmark.methods import errors, sampled
from rfpp.inference.renderer import Renderer
from rfpp.scene.packed import pack

EXHIBITS = {"six": pack(scene()).views([0]), "drawn": sampled(BoxFamily(), 0)}


def test_the_largest_affordable_sample_count():
    seconds = {4: 0.4, 1: 0.2, 2: 0.3, 8: 0.6}
    assert affordable(seconds, 0.5) == 4
    assert affordable(seconds, 0.6) == 8
    assert affordable(seconds, 9.0) == 8
    assert affordable({**seconds, 2: 0.7}, 0.5) == 4  # whatever fewer samples take
    assert affordable(seconds, 0.1) == 1


@pytest.fixture
def untrained(tmp_path):
    """Folder of an untrained network."""
    return str(Renderer(network(), checkpoint_info()).save(tmp_path / "net"))


def test_sample_counts_are_chosen_for_each_scene(untrained, tmp_path, monkeypatch):
    slow, images = len(EXHIBITS["six"].triangles), {}

    def traced(scenes, size, settings):
        """Yield images as bright as they have samples; four samples take long in the first scene."""
        images[settings.samples] = np.full((*size, 3), settings.samples / 8, np.float32)
        for one in scenes:
            yield images[settings.samples][None], 1e6 * (settings.samples == 4 and len(one.triangles) == slow)

    monkeypatch.setattr(methods, "path_traced", traced)
    picture = str(tmp_path / "g.png")
    rows = list(measure([untrained], EXHIBITS, 16, REFERENCE, REFERENCE, [1, 2, 4], picture, lambda *_: None))
    assert [row["cycles_samples"] for row in rows] == [2, 4]
    for row in rows:
        expected = errors(images[row["cycles_samples"]], images[REFERENCE.samples])
        assert {name: row[f"cycles_{name}"] for name in expected} == expected
        assert row["cycles_s"] <= row["seconds"]


@requires_blender
def test_a_row_and_a_line_of_pictures_for_each_scene(untrained, tmp_path):
    turns, picture = [], tmp_path / "g.png"
    rows = list(
        measure([untrained], EXHIBITS, 16, REFERENCE, REFERENCE, [1, 2], str(picture), lambda *turn: turns.append(turn))
    )
    assert turns == [(2, 8), (4, 8), (6, 8), (8, 8)]
    assert [(row["scene"], row["method"]) for row in rows] == [("six", "net"), ("drawn", "net")]
    for row in rows:
        assert row["seconds"] > 0 and row["reference_s"] > 0 and 0 < row["flip"] <= 1
        assert row["cycles_samples"] in (1, 2)
        assert row["cycles_samples"] == 1 or row["cycles_s"] <= row["seconds"]
        assert row["cycles_log_l1"] < row["log_l1"]  # few samples are better than an untrained network
    sheet = np.asarray(Image.open(picture))
    assert sheet.shape[0] > 2 * 160 and sheet.shape[1] > 5 * 160
