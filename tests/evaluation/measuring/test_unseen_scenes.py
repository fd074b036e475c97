"""Networks on stored scenes beside radiosity that learns nothing."""

import numpy as np
import pytest
import torch
from networks import checkpoint_info, model_config, network
from random_vgg import random_trunk
from small_data import Constant, make

from rfpp import Renderer
from rfpp.errors import UserError
from rfpp.evaluation.measuring.confidence import Bootstrap
from rfpp.evaluation.measuring.unseen_scenes import ByRadiosity, StoredScenes, measure
from rfpp.scene.packed import PackedScene
from rfpp.shards.dataset import ShardSplit

BASELINES = ("black", "mean image", "albedo x constant", "direct light alone", "reflections too")
LINEAR = "experiment=quickstart"


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """A folder with weights for LPIPS, a data set whose images are grey, and two networks, one of which adds light."""
    folder = tmp_path_factory.mktemp("unseen")
    torch.save(random_trunk(), folder / "vgg.pth")
    make(folder / "grey", render=Constant(0.3), resolution=16, splits={"validation": 2, "test": 3})
    untrained, info = network(LINEAR), checkpoint_info(model_config(LINEAR), resolution=(16, 16))
    Renderer(untrained, info).save(folder / "untrained")
    with torch.no_grad():
        untrained.decoder.shading.keys.weight.normal_()
        list(untrained.decoder.head.parameters())[-1].fill_(5.0)
    Renderer(untrained, info).save(folder / "brighter")
    return folder


@pytest.fixture(scope="module")
def rows(kept):
    sets = [StoredScenes(split, str(kept / "grey"), split) for split in ("validation", "test")]
    turns = []
    names = [str(kept / name) for name in ("untrained", "brighter")]
    fitted_on = StoredScenes("", str(kept / "grey"), "validation")
    measured = measure(names, sets, fitted_on, 2, Bootstrap(200, 0), lambda *turn: turns.append(turn), kept / "vgg.pth")
    found = {(row["data"], row["method"].split("/")[-1]): row for row in measured}
    assert turns == [(n, 5) for n in range(1, 6)]
    return found


def test_a_row_for_each_set_and_method(rows):
    methods = ("unlearned radiosity", "untrained", "brighter", *BASELINES)
    assert list(rows) == [(split, method) for split in ("validation", "test") for method in methods]
    assert [row["scenes"] for row in rows.values()] == [2] * 8 + [3] * 8


def test_baselines_stand_beside_the_networks(rows):
    for split in ("validation", "test"):  # grey images of 0.3
        assert rows[split, "black"]["log_l1"] == pytest.approx(np.log10(1.3), rel=1e-3)
        assert rows[split, "mean image"]["log_l1"] == pytest.approx(0, abs=1e-3)
        assert rows[split, "black"]["log_l1_change_low"] <= rows[split, "black"]["log_l1_change"]


def test_a_network_that_has_learned_nothing_is_radiosity(rows):
    for split in ("validation", "test"):
        radiosity, untrained = rows[split, "unlearned radiosity"], rows[split, "untrained"]
        for metric in ("log_l1", "lpips", "flip", "ssim"):
            assert radiosity[f"{metric}_change"] == 0
            assert untrained[metric] == pytest.approx(radiosity[metric], rel=0.02, abs=1e-4)


def test_changes_are_paired_and_relative_to_radiosity(rows):
    for split in ("validation", "test"):
        radiosity, brighter = rows[split, "unlearned radiosity"], rows[split, "brighter"]
        change = brighter["log_l1"] / radiosity["log_l1"] - 1
        assert brighter["log_l1_change"] == pytest.approx(change) and abs(change) > 1e-4
        assert brighter["log_l1_change_low"] <= change <= brighter["log_l1_change_high"]
        assert brighter["log_l1_low"] <= brighter["log_l1"] <= brighter["log_l1_high"]


def test_scenes_of_the_same_rooms_are_compared_one_by_one(kept):
    root = str(kept / "grey")
    sets = [StoredScenes("seen", root, "test"), StoredScenes("held out", root, "test", same_rooms_as="seen")]
    lpips = kept / "vgg.pth"
    rows = list(measure([], sets, None, 0, Bootstrap(200, 0), lambda *_: None, lpips))
    assert [row["data"] for row in rows if "log_l1_beside" in row] == ["held out"]
    assert rows[1]["log_l1_beside"] == rows[1]["log_l1_beside_high"] == 0  # each room beside itself
    sets = [StoredScenes("seen", root, "validation"), StoredScenes("held out", root, "test", same_rooms_as="seen")]
    with pytest.raises(UserError, match="'held out' has 3 scenes, 'seen' 2: generate as many"):
        list(measure([], sets, None, 0, Bootstrap(200, 0), lambda *_: None, lpips))


def test_radiosity_renders_every_view(kept):
    sample = ShardSplit(kept / "grey", "test").read(0, None, ())
    scene = PackedScene(sample.key, sample.triangles, sample.c2w, sample.fov)
    images = ByRadiosity()(scene, (16, 16))
    assert images.shape == (2, 16, 16, 3) and (images >= 0).all()
    np.testing.assert_allclose(images[1:], ByRadiosity()(scene.views([1]), (16, 16)))
    assert not np.allclose(images[0], images[1])
