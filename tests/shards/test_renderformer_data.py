"""Import of RenderFormer's H5 files: every scene exactly once, and bad files are named."""

import shutil
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from known_scenes import look_at, moved, rigid_motion, still_life
from small_data import SETTINGS, InProcess
from stored_sample import stored_sample

from rfpp.errors import SceneError, ShardError, UserError
from rfpp.scene.io.renderformer_h5 import save_h5
from rfpp.scene.packed import PackedScene
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.export import export
from rfpp.shards.generation import generate
from rfpp.shards.job import SceneTask
from rfpp.shards.renderformer_data import Import
from rfpp.shards.sample import SceneSample, decode
from rfpp.shards.tar import unpack

POSES = np.stack([look_at((0.3, -1.5, 0.9)), look_at((-0.4, -1.2, 1.1))])
FOV = np.array([40.0, 50.0], np.float32)


def scene(seed: int) -> PackedScene:
    return PackedScene(f"scene {seed}", still_life(seed), POSES, FOV)


@pytest.fixture(scope="module")
def samples() -> list[SceneSample]:
    return [replace(stored_sample(scene(seed), resolution=8), key=f"scene{seed}") for seed in range(5)]


@pytest.fixture(scope="module")
def exported(samples, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("exported")
    for sample in samples:
        path = export(sample, "h5", folder)[0]
        with h5py.File(path, "r+") as file:
            del file["object_index"]
    return folder


@pytest.fixture
def folder(exported, tmp_path) -> Path:
    """A copy of five H5 scenes in the layout of RenderFormer's tools."""
    return Path(shutil.copytree(exported, tmp_path / "h5"))


def recipe(folder: Path, root: Path, validation=0.0, test=0.3, **data):
    return Import(folder, validation, test).recipe(replace(SETTINGS, name="imported", root=str(root), **data))


def make(folder: Path, root: Path, **settings):
    return generate(recipe(folder, root, **settings), InProcess(), lambda done, total: None)


def sample_of(plan, key: str) -> SceneSample:
    name, members = unpack(plan.job(plan.task(key)).blocks)
    return decode(name, members)


def test_a_file_becomes_the_sample_it_was_exported_from(samples, folder, tmp_path):
    plan = recipe(folder, tmp_path / "data")
    found = [sample_of(plan, f"{split}-{index:06d}") for split, count in plan.splits.items() for index in range(count)]
    assert sorted(sample.meta["source"] for sample in found) == [f"scene{i}.h5" for i in range(5)]
    for sample in found:
        original = samples[int(sample.meta["source"][5])]
        rows = np.lexsort(sample.triangles.positions.reshape(-1, 9).T)
        expected = np.lexsort(original.triangles.positions.reshape(-1, 9).T)
        for name in ("positions", "normals"):
            given, wanted = getattr(sample.triangles, name), getattr(original.triangles, name)
            np.testing.assert_array_equal(given[rows], wanted[expected])
        halves = original.triangles.material[expected].astype(np.float16)
        np.testing.assert_array_equal(sample.triangles.material[rows], halves)
        np.testing.assert_array_equal(sample.images, original.images)
        np.testing.assert_array_equal(sample.c2w, original.c2w)
        for mine, theirs in zip(sample.gbuffers, original.gbuffers, strict=True):
            np.testing.assert_array_equal(mine.depth, theirs.depth)
            np.testing.assert_allclose(mine.normal, theirs.normal, atol=5e-4)  # computed from normals in half precision
            seen = sample.triangles.positions[mine.triangle[mine.hit]]
            np.testing.assert_array_equal(seen, original.triangles.positions[theirs.triangle[theirs.hit]])
            assert mine.light.diffuse.mean() == pytest.approx(theirs.light.diffuse.mean(), rel=0.1)


def test_a_data_set_of_files_is_read_like_any_other(folder, tmp_path):
    manifest = make(folder, tmp_path / "data")
    assert manifest.counts["scenes"] == 5 and manifest.counts["images"] == 10
    sources = {split: [s.meta["source"] for s in ShardSplit(manifest.root, split)] for split in manifest.splits}
    assert sorted(sources["train"] + sources["test"]) == [f"scene{i}.h5" for i in range(5)]
    assert len(sources["test"]) == 2
    assert all(names == sorted(names) for names in sources.values())
    assert manifest.settings["data"]["resolution"] == 8


def test_equal_files_give_equal_bytes_in_any_folder(folder, tmp_path):
    first = make(folder, tmp_path / "a")
    again = make(folder.rename(tmp_path / "elsewhere"), tmp_path / "b")
    assert first.hash == again.hash


def test_a_sample_depends_on_its_file_alone(folder, tmp_path):
    plan = recipe(folder, tmp_path / "data")
    before = {s.meta["source"]: s for s in (sample_of(plan, f"train-{i:06d}") for i in range(3))}
    others = sorted(path.name for path in folder.glob("*.h5") if path.name not in before)
    (folder / others[0]).unlink()
    for index in range(recipe(folder, tmp_path / "data").splits["train"]):
        sample = sample_of(recipe(folder, tmp_path / "data"), f"train-{index:06d}")
        if sample.meta["source"] in before:
            for mine, theirs in zip(sample.gbuffers, before[sample.meta["source"]].gbuffers, strict=True):
                np.testing.assert_array_equal(mine.light.glossy, theirs.light.glossy)


def test_files_are_split_by_shares_without_overlap(folder):
    for validation, test, counts in ((0.0, 0.0, [5, 0, 0]), (0.2, 0.4, [2, 1, 2]), (0.01, 0.0, [4, 1, 0])):
        splits = Import(folder, validation, test).splits
        assert [len(splits[split]) for split in ("train", "validation", "test")] == counts
        assert sorted(path for part in splits.values() for path in part) == sorted(folder.glob("*.h5"))


def test_changed_files_are_not_mixed_with_existing_data(folder, tmp_path):
    make(folder, tmp_path / "data")
    save_h5(scene(7), folder / "scene7.h5", np.zeros((2, 8, 8, 3), np.float32))
    with pytest.raises(ShardError, match="holds data made with other settings"):
        make(folder, tmp_path / "data")


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda file: file.__delitem__("img"), "the data set 'img' is missing"),
        (lambda file: file["img"].__setitem__((0, 0, 0), np.inf), "img: holds NaN or infinity"),
        (lambda file: file["texture"].__setitem__((0, 0, 3, 4), 0.1), "texture: varies within triangles"),
        (lambda file: file.__delitem__("vn"), "the data set 'vn' is missing"),
    ],
)
def test_an_unusable_file_is_named(folder, tmp_path, spoil, message):
    bad = Import(folder, 0, 0.3).splits["train"][1]
    with h5py.File(bad, "r+") as file:
        spoil(file)
    with pytest.raises(SceneError, match=message) as caught:
        recipe(folder, tmp_path / "data").job(SceneTask("train", 1))
    assert str(bad) in str(caught.value)


def test_other_files_are_imported_despite_a_failure(folder, tmp_path):
    bad = Import(folder, 0, 0.3).splits["train"][1]
    with h5py.File(bad, "r+") as file:
        del file["vn"]
    with pytest.raises(ShardError, match=rf"1 of 5 scenes failed.*{bad.name}"):
        make(folder, tmp_path / "data")
    assert (tmp_path / "data" / "test-00000.tar").is_file()


@pytest.mark.parametrize(("views", "height", "width"), [(1, 8, 8), (2, 16, 16)])
def test_files_of_other_shapes_are_named(folder, tmp_path, views, height, width):
    odd = PackedScene("odd", moved(still_life(), rigid_motion()), POSES[:views], FOV[:views])
    save_h5(odd, folder / "strange.h5", np.ones((views, height, width, 3), np.float32))
    with pytest.raises(SceneError, match=rf"strange\.h5: {views} views of {height} x {width} pixels.*scene0\.h5 has 2"):
        recipe(folder, tmp_path / "data")


@pytest.mark.parametrize(
    ("prepare", "shares", "message"),
    [
        (lambda folder: None, (0, 0), "no such folder"),
        (lambda folder: folder.mkdir(), (0, 0), r"holds no \*\.h5 files"),
        (lambda folder: save_h5(scene(0), folder / "a.h5"), (0, 0.1), "1 files, and none is left for training"),
        (lambda folder: save_h5(scene(0), folder / "a.h5"), (-0.1, 0), "share for validation is -0.1"),
    ],
)
def test_invalid_folders_and_shares_are_named(tmp_path, prepare, shares, message):
    prepare(tmp_path / "h5")
    with pytest.raises(UserError, match=message):
        Import(tmp_path / "h5", *shares)
