"""The streaming benchmark, on data that is small: what is compared is the same data, read in different ways."""

from dataclasses import replace

import numpy as np
import pytest
from small_data import REFERENCE, SETTINGS, BoxFamily, make

from rfpp.benchmark.invented import InventedData, StoredData, invented_light
from rfpp.benchmark.streaming import PAPER_IMAGES_PER_SECOND, measure
from rfpp.reference.farm import RenderFarm
from rfpp.scene.camera import camera_to_world
from rfpp.scene.triangles import SceneTriangles
from rfpp.shards.cache import ShardCache
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.manifest import Manifest
from rfpp.training.datamodule import SceneDataModule
from rfpp.training.dealing import InOrder


@pytest.fixture
def invented():
    return InventedData(BoxFamily(), SETTINGS, REFERENCE, RenderFarm(workers=1), scenes=3)


def datamodule(root, workers):
    return SceneDataModule(
        root=root, workers=workers, cache=ShardCache("unused", 1), gbuffer_channels=("albedo",), scenes_per_step=2,
        scenes_per_device=None, dealing=InOrder(), views_per_scene=2, training_scenes=None, validation_scenes=1,
        shuffle_shards=4, skip_corrupt=False, rigid_augmentation=None, colour_augmentation=None,
        light_augmentation=None, seed=0,
    )  # fmt: skip


def test_every_way_of_reading_is_measured_on_every_data_set(invented, tmp_path):
    finished = make(tmp_path / "stored", splits={"train": 3})
    made = []
    sources = {"invented": invented, "stored": StoredData(str(finished.root))}
    rows = measure(sources, datamodule, workers=[0], batches=3, rounds=1, progress=lambda *n: made.append(n))
    readers = ["positioned reads", "webdataset, undecoded", "training loader"]
    assert [(row["data"], row["reader"]) for row in rows] == [(d, r) for d in sources for r in readers]
    for row in rows:
        assert row["scenes_per_s"] > 0
        assert row["resolution"] == 8
        assert row["triangles"] == 7
        assert row["images_per_s"] == pytest.approx(2 * row["scenes_per_s"])
        assert row["MB_per_s"] == pytest.approx(row["MB_per_scene"] * row["scenes_per_s"])
        assert row["times_paper"] == pytest.approx(row["images_per_s"] / PAPER_IMAGES_PER_SECOND)
    assert [row["of_positioned_reads"] for row in rows[::3]] == [1, 1]
    train = finished.samples("train")
    assert rows[3]["MB_per_scene"] == pytest.approx(sum(entry.size for entry in train) / len(train) / 1e6)
    assert made[-1] == (6, 6)


def test_invented_data_are_the_scenes_of_the_family(invented, tmp_path):
    root = invented.root(tmp_path / "data", lambda done, total: None)
    assert Manifest.load(root).counts["scenes"] == 3
    scene = ShardSplit(root, "train")[0]
    assert scene.triangles.num_objects == 3
    assert scene.images.mean() > 0.01


def test_invented_light_is_lit_by_the_lights_alone_and_depends_on_the_seed():
    scene = BoxFamily().sample(np.random.default_rng(1), np.random.default_rng(2), held_out=False)
    triangles = SceneTriangles.from_scene(scene)
    c2w = np.stack([camera_to_world(camera) for camera in scene.cameras])
    fov = np.array([camera.fov for camera in scene.cameras], np.float32)

    def image(triangles: SceneTriangles, seed: int) -> np.ndarray:
        return invented_light(triangles, c2w, fov, 12, 12, replace(REFERENCE, seed=seed))

    np.testing.assert_array_equal(image(triangles, 1), image(triangles, 1))
    assert not np.array_equal(image(triangles, 1), image(triangles, 2))
    dimmed = triangles.material.copy()
    dimmed[:, 7:] /= 2
    np.testing.assert_allclose(image(replace(triangles, material=dimmed), 1), image(triangles, 1) / 2, rtol=1e-3)
