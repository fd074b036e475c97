from functools import partial

import pytest
from small_data import REFERENCE, SETTINGS, BoxFamily, make

from rfpp.benchmark.streaming import PAPER_IMAGES_PER_SECOND, SyntheticData, measure
from rfpp.inference.radiosity_labels import RadiosityLabels
from rfpp.reference.farm import RenderFarm
from rfpp.shards.cache import ShardCache
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.manifest import Manifest
from rfpp.training.batching import Batching, Contiguous
from rfpp.training.datamodule import SceneDataModule
from rfpp.training.source import DataSource

LABELS = RadiosityLabels(REFERENCE, light_samples=1, points=1, token_bounces=None, seed=0)


@pytest.fixture
def synthetic():
    return SyntheticData(BoxFamily(), SETTINGS, LABELS, RenderFarm(workers=1), scenes=3)


SOURCE = partial(
    DataSource, cache=ShardCache("unused", 1), training_scenes=None, validation_scenes=0, skip_corrupt=False
)
BATCHING = Batching(
    scenes_per_step=2, scenes_per_device=None, views_per_scene=2, partition=Contiguous(), shuffle_shards=4
)
DATAMODULE = partial(SceneDataModule, batching=BATCHING, gbuffer_channels=("albedo",), augmentation={}, seed=0)


def test_a_row_for_each_data_set_and_number_of_workers(synthetic, tmp_path):
    finished = make(tmp_path / "stored", splits={"train": 3})
    sources, turns = {"synthetic": synthetic, "stored": str(finished.root)}, []
    rows = list(
        measure(sources, SOURCE, DATAMODULE, [0], batches=3, rounds=2, progress=lambda *turn: turns.append(turn))
    )
    assert [(row["data"], row["workers"]) for row in rows] == [("synthetic", 0), ("stored", 0)]
    for row in rows:
        assert row["scenes_per_s"] > 0 and row["cpu_ms_per_scene"] > 0
        assert (row["resolution"], row["triangles"]) == (8, 7)
        assert row["images_per_s"] == pytest.approx(2 * row["scenes_per_s"])
        assert row["MB_per_s"] == pytest.approx(row["MB_per_scene"] * row["scenes_per_s"])
        assert row["times_paper"] == pytest.approx(row["images_per_s"] / PAPER_IMAGES_PER_SECOND)
    train = finished.samples("train")
    assert rows[1]["MB_per_scene"] == pytest.approx(sum(entry.size for entry in train) / len(train) / 1e6)
    assert turns == [(n, 4) for n in range(1, 5)]


def test_synthetic_data_sets_hold_scenes_of_the_family(synthetic, tmp_path):
    synthetic.write(tmp_path, lambda done, total: None)
    assert Manifest.load(tmp_path).counts["scenes"] == 3
    scene = ShardSplit(tmp_path, "train")[0]
    assert scene.triangles.num_objects == 3
    assert scene.images.mean() > 0.01
