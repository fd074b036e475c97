"""Real loaders: equal batches for any number of ranks and workers, exact resumption, and handling of damage."""

import itertools
import json
import os
import shutil
import signal
from dataclasses import dataclass
from multiprocessing import active_children
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import trimesh
from small_data import BoxFamily, make

from rfpp.errors import ShardError, UserError
from rfpp.scene.mesh import Mesh
from rfpp.scene.spec import SceneObject, Transform
from rfpp.shards.cache import ShardCache
from rfpp.shards.manifest import Manifest
from rfpp.training.augmentation import RigidMotion
from rfpp.training.batching import BalancedBySize, Batching, Contiguous
from rfpp.training.datamodule import SceneDataModule
from rfpp.training.readers import IndexedReader, WebDatasetReader
from rfpp.training.source import DataSource

SCENES, PER_STEP, STEPS = 7, 4, 5  # two epochs and six scenes


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    splits = {"train": SCENES, "validation": 1}
    return make(tmp_path_factory.mktemp("loader") / "small", splits=splits, scenes_per_shard=2).root


def datamodule(root, rank: int = 0, ranks: int = 1, accumulate: int = 1, steps: int = STEPS, **change):
    """Return the data module of one of `ranks`; `change` replaces settings of any of its parts."""
    source = {
        "root": root, "cache": ShardCache("unused", 1.0), "training_scenes": None, "validation_scenes": 1,
        "skip_corrupt": False,
    }  # fmt: skip
    batching = {
        "scenes_per_step": PER_STEP, "scenes_per_device": None, "views_per_scene": 1, "partition": Contiguous(),
        "shuffle_shards": 2,
    }  # fmt: skip
    augmentation = {"rigid": RigidMotion(1.0, 0.25), "color": None}
    others = {
        "gbuffer_channels": ("albedo",), "augmentation": augmentation, "workers": 0, "seed": 5,
        "reader": IndexedReader(),
    }  # fmt: skip
    assert change.keys() <= {*source, *batching, *others}
    source, batching, others = (
        {name: change.get(name, value) for name, value in part.items()} for part in (source, batching, others)
    )
    data = SceneDataModule(DataSource(**source), batching=Batching(**batching), **others)
    data.trainer = SimpleNamespace(
        world_size=ranks, global_rank=rank, max_steps=steps, accumulate_grad_batches=accumulate, global_step=0,
        strategy=SimpleNamespace(root_device=torch.device("cpu")),
    )  # fmt: skip
    return data


def global_batches(root, ranks: int = 1, **how) -> list[list[tuple[str, bytes]]]:
    """Return the scenes of each global batch: keys, poses and images."""
    parts = [list(datamodule(root, rank, ranks, **how).train_dataloader()) for rank in range(ranks)]
    return [
        [
            (key, pose.numpy().tobytes() + image.numpy().tobytes())
            for batch in shares
            for key, pose, image in zip(batch.keys, batch.c2w, batch.image, strict=True)
        ]
        for shares in zip(*parts, strict=True)
    ]


@pytest.fixture(scope="module")
def uninterrupted(root):
    return global_batches(root)


def test_each_scene_comes_once_per_epoch(uninterrupted):
    keys = [key for batch in uninterrupted for key, _ in batch]
    assert len(keys) == STEPS * PER_STEP
    assert len(set(keys[:SCENES])) == len(set(keys[SCENES : 2 * SCENES])) == SCENES
    assert keys[:SCENES] != keys[SCENES : 2 * SCENES]


@pytest.mark.filterwarnings("ignore:This DataLoader will create")
@pytest.mark.parametrize(("ranks", "workers"), [(2, 0), (4, 0), (1, 2)])
def test_batches_are_the_same_for_any_number_of_ranks_and_workers(root, uninterrupted, ranks, workers):
    assert global_batches(root, ranks, workers=workers) == uninterrupted


@pytest.mark.parametrize("step", range(STEPS + 1))
def test_resuming_at_any_step_yields_the_remaining_batches(root, uninterrupted, step):
    before = datamodule(root)
    before.trainer.global_step = step
    state = json.loads(json.dumps(before.state_dict()))
    for ranks in (1, 2):
        parts = []
        for rank in range(ranks):
            after = datamodule(root, rank, ranks)
            after.load_state_dict(state)
            parts.append([batch.keys for batch in after.train_dataloader()])
        keys = [[key for share in shares for key in share] for shares in zip(*parts, strict=True)]
        assert keys == [[key for key, _ in batch] for batch in uninterrupted[step:]]


@pytest.mark.parametrize(
    ("per_step", "per_device", "devices", "batches"),
    [(16, None, 8, 1), (16, 2, 8, 1), (16, 2, 1, 8), (16, 2, 2, 4), (12, 5, 1, 3), (7, 3, 1, 7), (16, 2, 16, 1)],
)
def test_a_device_accumulates_beyond_its_limit(root, per_step, per_device, devices, batches):
    data = datamodule(root, scenes_per_step=per_step, scenes_per_device=per_device)
    assert data.batching.accumulation(devices) == batches


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"scenes_per_step": 16}, r"scenes_per_step=16 does not divide among 3 devices .*choose a multiple"),
        ({"scenes_per_step": 0}, "scenes_per_step=0 does not divide"),
        ({"scenes_per_step": 3, "scenes_per_device": 0}, "scenes_per_device=0: use 1 or more"),
    ],
)
def test_indivisible_batches_are_refused(root, change, named):
    with pytest.raises(UserError, match=named):
        datamodule(root, **change).batching.accumulation(3)


def test_accumulation_divides_the_same_batches(root, uninterrupted):
    def keys(batches):
        return [key for batch in batches for key in batch.keys]

    whole = [key for batch in uninterrupted for key, _ in batch]
    halves = list(datamodule(root, accumulate=2).train_dataloader())
    assert len(halves) == 2 * STEPS
    assert keys(halves) == whole
    quarters = [list(datamodule(root, rank, 2, accumulate=2).train_dataloader()) for rank in (0, 1)]
    steps = zip(*(zip(part[::2], part[1::2], strict=True) for part in quarters), strict=True)
    assert [key for step in steps for parts in step for key in keys(parts)] == whole


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"seed": 6}, "seed=5, this one 6"),
        ({"reader": WebDatasetReader(2)}, "datamodule.reader=indexed, this one webdataset"),
        ({"scenes_per_step": 2}, "datamodule.batching.scenes_per_step=4, this one 2"),
        ({"shuffle_shards": 1}, "datamodule.batching.shuffle_shards=2, this one 1"),
        ({"training_scenes": 3}, "datamodule.source.training_scenes=None, this one 3"),
    ],
)
def test_a_run_with_another_order_is_not_resumed(root, change, named):
    with pytest.raises(UserError, match=f"the run to resume had {named}"):
        datamodule(root, **change).load_state_dict(datamodule(root).state_dict())


def test_only_the_first_scenes_are_trained_on(root):
    keys = {key for batch in global_batches(root, training_scenes=3) for key, _ in batch}
    assert keys == {"train-000000", "train-000001", "train-000002"}


def damaged(root: Path, target: Path, *keys: str) -> Path:
    """Copy a data set and flip a byte of each of these scenes."""
    shutil.copytree(root, target)
    manifest = Manifest.load(target)
    for shard in manifest.shards("train"):
        content = bytearray((target / shard.listed.file).read_bytes())
        for entry in shard.index().samples:
            if entry.key in keys:
                content[entry.offset + entry.size // 2] ^= 1
        (target / shard.listed.file).write_bytes(content)
    return target


def test_training_stops_at_damage_with_one_line_that_names_it(root, tmp_path):
    bad = damaged(root, tmp_path / "bad", "train-000003")
    with pytest.raises(ShardError) as stop:
        global_batches(bad, workers=1)
    assert "train-00001.tar: sample train-000003 does not have the recorded sha256: delete" in str(stop.value)
    assert "\n" not in str(stop.value)
    assert str(stop.value).startswith(str(bad))


def test_damaged_scenes_are_skipped_without_replacement(root, tmp_path, uninterrupted):
    bad = damaged(root, tmp_path / "bad", "train-000003", "train-000006")
    with pytest.warns(UserWarning, match="skipped: .*train-0000.*sha256") as warned:
        batches = global_batches(bad, skip_corrupt=True)
    intact = [[(k, v) for k, v in batch if k not in ("train-000003", "train-000006")] for batch in uninterrupted]
    assert batches == intact
    assert len({str(w.message) for w in warned}) == 2


def test_missing_and_truncated_shards_are_skipped(root, tmp_path, uninterrupted):
    bad = Path(shutil.copytree(root, tmp_path / "bad"))
    (bad / "train-00000.tar").unlink()
    (bad / "train-00001.tar").write_bytes((bad / "train-00001.tar").read_bytes()[:-1])
    with pytest.raises(ShardError, match=r"train-00000\.tar: the shard is missing"):
        global_batches(bad)
    with pytest.warns(UserWarning, match="skipped"):
        keys = [key for batch in global_batches(bad, skip_corrupt=True) for key, _ in batch]
    gone = {f"train-00000{i}" for i in range(4)}
    assert keys == [key for batch in uninterrupted for key, _ in batch if key not in gone]


def test_a_batch_without_readable_scenes_has_no_weight(root, tmp_path, uninterrupted):
    lost = [key for key, _ in uninterrupted[1]]
    bad = damaged(root, tmp_path / "bad", *lost)
    with pytest.warns(UserWarning, match="skipped"):
        first, second, third = itertools.islice(datamodule(bad, skip_corrupt=True).train_dataloader(), 3)
    assert second.keys == ()
    assert torch.equal(second.image, first.image)
    assert set(third.keys) == {key for key, _ in uninterrupted[2]} - set(lost)


def test_loader_processes_survive_stop_signals(root, uninterrupted):
    """Slurm signals every process of a job; the ranks need their data until they have agreed and saved."""
    before = set(active_children())
    loader = iter(datamodule(root, workers=1).train_dataloader())
    keys = [next(loader).keys]
    [worker] = set(active_children()) - before
    for name in ("SIGUSR1", "SIGTERM", "SIGINT"):
        os.kill(worker.pid, signal.Signals[name])
    keys += [batch.keys for batch in loader]
    assert keys == [tuple(key for key, _ in batch) for batch in uninterrupted]


@dataclass(frozen=True)
class Grown(BoxFamily):
    """Boxes; every second scene has another thousand triangles."""

    def sample(self, scene_rng, camera_rng, *, held_out):
        scene = super().sample(scene_rng, camera_rng, held_out=held_out)
        if scene_rng.random() < 0.5:
            return scene
        fine = trimesh.creation.icosphere(3, 0.1)
        ball = {"mesh": Mesh(fine.vertices, fine.faces), "transform": Transform(normalize=False)}
        ball = SceneObject(name="ball", material=scene.objects[0].material, **ball)
        return scene.model_copy(update={"objects": (*scene.objects, ball)})


@pytest.fixture(scope="module")
def skewed(tmp_path_factory):
    """Scenes of two sizes, in shards of four."""
    folder = tmp_path_factory.mktemp("skewed") / "small"
    return make(folder, Grown(), splits={"train": 12, "validation": 1}, scenes_per_shard=4).root


def triangles_of_ranks(root, partition, **how) -> np.ndarray:
    """[ranks, steps]"""
    loaders = [datamodule(root, rank, 2, partition=partition, **how).train_dataloader() for rank in (0, 1)]
    return np.array([[len(batch.positions) for batch in loader] for loader in loaders])


def test_sizes_in_the_index_balance_the_load_of_ranks(skewed):
    how = {"shuffle_shards": 3, "steps": 12, "seed": 1}
    contiguous, balanced = (triangles_of_ranks(skewed, p, **how) for p in (Contiguous(), BalancedBySize()))
    assert (contiguous.sum(0) == balanced.sum(0)).all()
    small, large = 7, 7 + 1280
    scenes_over = (balanced.sum(0) - 4 * small) // (large - small) % 2  # an odd number of large ones cannot be halved
    assert (np.abs(np.diff(balanced, axis=0))[0] == scenes_over * (large - small)).all()
    assert np.abs(np.diff(contiguous, axis=0)).sum() > np.abs(np.diff(balanced, axis=0)).sum()


def test_a_shard_without_index_is_skipped(skewed, tmp_path):
    bad = Path(shutil.copytree(skewed, tmp_path / "bad"))
    (bad / "train-00000.json").unlink()
    with pytest.raises(ShardError, match=r"train-00000\.json: the index cannot be read"):
        triangles_of_ranks(bad, BalancedBySize())
    how = {"partition": BalancedBySize(), "steps": 3, "shuffle_shards": 3, "skip_corrupt": True}
    loaders = [datamodule(bad, rank, 2, **how).train_dataloader() for rank in (0, 1)]
    with pytest.warns(UserWarning, match="skipped"):
        keys = [key for loader in loaders for batch in loader for key in batch.keys]
    assert sorted(keys) == [f"train-{i:06d}" for i in range(4, 12)]


def test_a_batch_without_readable_scenes_is_an_error(root, tmp_path):
    bad = damaged(root, tmp_path / "bad", *(f"train-00000{i}" for i in range(SCENES)))
    nothing_left = pytest.raises(ShardError, match="none of a batch's 4 scenes can be read")
    with nothing_left, pytest.warns(UserWarning, match="skipped"):
        global_batches(bad, skip_corrupt=True)
