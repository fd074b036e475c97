"""Making data sets: splits, rejections, resumption after anything, refusal to mix."""

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from filelock import FileLock
from marks import requires_blender
from small_data import ACCEPTANCE, REFERENCE, SETTINGS, BoxFamily, Constant, Interrupting, make, recipe

from rfpp.errors import MissingDependencyError, ShardError, UserError
from rfpp.reference import cycles
from rfpp.reference.farm import RenderFarm
from rfpp.shards import generation, writer
from rfpp.shards.manifest import Manifest
from rfpp.shards.recipe import Slice
from rfpp.shards.status import status
from rfpp.shards.stream import ShardSplit
from rfpp.shards.verification import verify


class InterruptAfter:
    """A progress callback that is Ctrl-C after `count` new scenes."""

    def __init__(self, count: int) -> None:
        self.count = count

    def __call__(self, done: int, total: int) -> None:
        if done >= self.count:
            raise KeyboardInterrupt


def scenes(manifest: Manifest, split: str) -> list:
    data = ShardSplit(manifest.root, split)
    return [data[i] for i in range(len(data))]


def hashes(root: Path) -> dict[str, str]:
    content = json.loads((root / "manifest.json").read_text())
    return {shard["file"]: shard["sha256"] for shards in content["splits"].values() for shard in shards}


def test_counts_files_and_keys(finished):
    assert [shard.samples for shard in finished.shards("train")] == [2, 2, 1]
    assert [entry.key for entry in finished.samples("test")] == ["test-000000", "test-000001"]
    assert finished.counts["scenes"] == 10
    assert finished.counts["images"] == 20
    assert finished.counts["triangles"] == 10 * 7
    assert finished.counts["bytes"] == sum(path.stat().st_size for path in finished.root.glob("*.tar"))
    assert finished.settings["data"]["resolution"] == 8
    assert finished.settings["scene"] == "boxes"
    assert not list(finished.root.glob(".*"))


def test_new_views_show_training_scenes_to_other_cameras(finished):
    train, newviews = scenes(finished, "train"), scenes(finished, "train_newviews")
    for seen, again in zip(train[:3], newviews, strict=True):
        np.testing.assert_array_equal(seen.triangles.positions, again.triangles.positions)
        np.testing.assert_array_equal(seen.triangles.material, again.triangles.material)
        assert not any(np.allclose(a, b) for a in seen.c2w for b in again.c2w)


def test_test_scenes_are_none_of_the_training_scenes(finished):
    colours = {tuple(s.triangles.material[2]) for split in ("train", "test") for s in scenes(finished, split)}
    assert len(colours) == 7


def test_noise_differs_between_samples(finished):
    ratio = [s.images / (s.triangles.material[2, :3] + 0.1) for s in scenes(finished, "train")]
    assert not np.allclose(ratio[0], ratio[1], rtol=0.01)


def test_the_same_command_again_does_nothing(copied, finished):
    before = {path.name: path.stat().st_mtime_ns for path in copied.iterdir()}
    calls = []
    again = make(copied, render=Constant(np.nan), progress=lambda *counts: calls.append(counts))
    assert {path.name: path.stat().st_mtime_ns for path in copied.iterdir()} == before
    assert again.hash == finished.hash
    assert calls == [(10, 10)]


@pytest.mark.parametrize(("workers", "count"), [(1, 2), (1, 3), (3, 3)])  # the end of a shard; the middle of one
def test_resumption_gives_what_an_uninterrupted_run_gives(tmp_path, finished, workers, count):
    with pytest.raises(KeyboardInterrupt):
        make(tmp_path, progress=InterruptAfter(count), workers=workers)
    assert not (tmp_path / "manifest.json").exists()
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*") if path.is_file()}
    resumed = []
    manifest = make(tmp_path, progress=lambda done, total: resumed.append(done), workers=workers)
    assert resumed[0] >= count
    assert all(path.stat().st_mtime_ns == when for path, when in kept.items() if path.exists())
    assert hashes(tmp_path) == hashes(finished.root)
    assert manifest.hash == finished.hash
    assert not (tmp_path / "unfinished").exists()


def test_a_half_written_sample_is_made_again(tmp_path, finished):
    with pytest.raises(KeyboardInterrupt):
        make(tmp_path, progress=InterruptAfter(1))
    [waiting] = tmp_path.rglob("*.sample")
    waiting.write_bytes(waiting.read_bytes()[:-100])
    assert make(tmp_path).hash == finished.hash


def test_samples_that_wait_are_not_mixed_with_other_settings(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        make(tmp_path, progress=InterruptAfter(1))
    (tmp_path / "settings.json").unlink()
    with pytest.raises(ShardError, match=r"train-000000\.sample: was made with other settings.*data\.name"):
        make(tmp_path, seed=8)


def test_kill_and_rerun_gives_identical_hashes(tmp_path, finished):
    root = tmp_path / "data"
    command = f"from pathlib import Path; from small_data import make; make(Path({str(root)!r}))"
    script = tmp_path / "run.py"
    script.write_text(f"if __name__ == '__main__':\n    {command}\n")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([*sys.path])}
    for wanted in ("unfinished/train-00000/train-000000.sample", "train-00000.tar", "train-00002.tar"):
        run = subprocess.Popen([sys.executable, script], env=environment, start_new_session=True)
        deadline = time.monotonic() + 60
        while not list(root.glob(wanted)) and run.poll() is None and time.monotonic() < deadline:
            time.sleep(0.001)
        os.killpg(run.pid, signal.SIGKILL)
        run.wait()
        assert list(root.rglob("*.sample")) or list(root.glob("*.tar"))
    assert make(root).hash == finished.hash


def test_a_deleted_shard_is_made_again(copied, finished):
    (copied / "train-00001.tar").unlink()
    (copied / "train-00001.json").unlink()
    assert make(copied).hash == finished.hash
    assert hashes(copied) == hashes(finished.root)


def test_a_larger_split_keeps_what_is_there(copied, finished):
    grown = make(copied, splits={"train": 6, "train_newviews": 3, "test": 2})
    assert [e.sha256 for e in grown.samples("train")][:5] == [e.sha256 for e in finished.samples("train")]
    assert len(ShardSplit(copied, "train")) == 6


def test_failing_scenes_are_listed_and_the_rest_is_kept(tmp_path, finished):
    flag = tmp_path / "flag"
    flag.touch()
    renderer = Interrupting(flag, below=0.3)
    failing = [
        sample.key
        for split in finished.splits
        for sample in scenes(finished, split)
        if sample.triangles.material[2, 0] < 0.3
    ]
    assert 0 < len(failing) < 10
    root = tmp_path / "data"
    with pytest.raises(ShardError, match=rf"{len(failing)} of 10 scenes failed.*the renderer fell over.*reproduce"):
        make(root, render=renderer)
    assert sorted(path.name for path in root.rglob("*.failed.json")) == sorted(f"{key}.failed.json" for key in failing)
    listed = json.loads(next(root.rglob(f"{failing[0]}.failed.json")).read_text())
    assert "__call__" in listed["traceback"]
    assert "the renderer fell over" in listed["error"]
    of_splits = status(recipe(root)).splits.values()
    assert sorted(key for split in of_splits for key in split.failures) == sorted(failing)
    with pytest.raises(RuntimeError, match="the renderer fell over"):
        recipe(root, render=renderer).job(recipe(root).task(failing[0]))
    flag.unlink()
    calls = []
    assert make(root, render=renderer, progress=lambda done, total: calls.append(done)).hash == finished.hash
    assert calls[0] == 10 - len(failing)
    assert not (root / "unfinished").exists()


def test_views_that_see_too_little_are_drawn_anew_and_counted(tmp_path):
    manifest = make(tmp_path, BoxFamily(looks_away=0.5))
    assert manifest.counts["empty_views"] > 0
    assert manifest.counts["scene_redraws"] == manifest.counts["unlit_views"] == 0
    for split in manifest.splits:
        for sample, entry in zip(scenes(manifest, split), manifest.samples(split), strict=True):
            assert min(gbuffer.hit.mean() for gbuffer in sample.gbuffers) >= 0.4
            assert not np.allclose(sample.c2w[0], sample.c2w[1])
            assert sample.meta["redraws"] == {
                name: getattr(entry, name) for name in ("scene_redraws", "empty_views", "unlit_views")
            }


def test_dark_scenes_are_drawn_anew_before_they_are_rendered_and_new_views_follow(tmp_path):
    manifest = make(tmp_path, BoxFamily(night=0.5), acceptance=replace(ACCEPTANCE, camera_attempts=2))
    train, newviews = scenes(manifest, "train"), scenes(manifest, "train_newviews")
    drawn = manifest.samples("train")
    assert sum(entry.unlit_views for entry in drawn) == 2 * 2 * sum(entry.scene_redraws for entry in drawn) > 0
    assert any(e.scene_redraws for e in manifest.samples("train_newviews"))
    assert all(sample.triangles.material[-1, 7] == 3000 for sample in train + newviews)
    for seen, again in zip(train[:3], newviews, strict=True):
        np.testing.assert_array_equal(seen.triangles.positions, again.triangles.positions)


@pytest.mark.parametrize("family", [BoxFamily(looks_away=1.0), BoxFamily(night=1.0)])
def test_hopeless_scenes_end_with_one_line(tmp_path, family):
    few = replace(ACCEPTANCE, camera_attempts=2, scene_attempts=2)
    with pytest.raises(ShardError, match=r"train-000000.*no acceptable views.*(8|0) too little light.*min_coverage"):
        make(tmp_path, family, acceptance=few, splits={"train": 1})


def test_radiance_that_does_not_fit_is_a_failure_that_names_the_scene(tmp_path):
    with pytest.raises(ShardError, match=r"train-000000.*beyond half precision"):
        make(tmp_path, render=Constant(1e5), splits={"train": 1})


def test_other_settings_are_refused_with_key_folder_and_remedy(copied):
    with pytest.raises(ShardError, match=rf"{copied}.*data\.resolution \(8 there, 16 now\).*data\.name"):
        make(copied, resolution=16)
    with pytest.raises(ShardError, match="scene"):
        make(copied, groups={"scene": "spheres"})
    (copied / "settings.json").unlink()
    with pytest.raises(ShardError, match=r"train-00000\.tar was made with other settings"):
        make(copied, seed=8)


def test_a_full_disk_names_the_shard_and_keeps_finished_ones(tmp_path, finished, monkeypatch):
    def full_after_first(descriptor: int) -> None:
        if (tmp_path / "train-00000.tar").exists():
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(writer.os, "fsync", full_after_first)
        with pytest.raises(UserError, match=r"train-00001\.tar.*No space left.*free space"):
            make(tmp_path)
    assert sorted(path.name for path in tmp_path.glob("*.*")) == [
        "settings.json",
        "train-00000.json",
        "train-00000.tar",
    ]
    assert make(tmp_path).hash == finished.hash


class WithoutBlender:
    def __call__(self, *args):
        raise MissingDependencyError("reference images need Blender: pip install it")


def test_missing_blender_ends_the_run_at_once(tmp_path):
    with pytest.raises(MissingDependencyError, match="need Blender"):
        make(tmp_path, render=WithoutBlender())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"views": 0}, r"data\.views is 0"),
        ({"seed": -1}, r"data\.seed is -1"),
        ({"splits": {"train": 2, "holdout": 1}}, r"data\.splits\.holdout.*choose from train"),
        ({"splits": {"train": -2}}, r"data\.splits\.train is -2"),
        ({"splits": {"train": 2, "train_newviews": 3}}, "train_newviews is larger"),
    ],
)
def test_bad_settings_are_named(change, message):
    with pytest.raises(UserError, match=message):
        replace(SETTINGS, **change)


@pytest.mark.parametrize(
    ("change", "message"),
    [({"min_coverage": 1.5}, r"acceptance\.min_coverage is 1\.5"), ({"resolution": 0}, r"acceptance\.resolution is 0")],
)
def test_bad_acceptance_is_named(change, message):
    with pytest.raises(UserError, match=message):
        replace(ACCEPTANCE, **change)


def test_the_number_of_views_must_be_the_familys(tmp_path):
    with pytest.raises(UserError, match=r"draws 3 cameras, data\.views is 2"):
        make(tmp_path, BoxFamily(views=3))


@dataclass(frozen=True)
class Sabotaged:
    """Cycles, but the worker of the first scene is killed in the middle of it, and that of the second stops dead."""

    folder: Path

    def __call__(self, triangles, *args) -> np.ndarray:
        images = cycles.render(triangles, *args)
        seen = self.folder / f"{triangles.material[2, 0]}.seen"
        number = len(list(self.folder.glob("*.seen")))
        if number < 2 and not seen.exists():
            seen.touch()
            os.kill(os.getpid(), (signal.SIGKILL, signal.SIGSTOP)[number])
        return images


@requires_blender
def test_killed_and_hanging_workers_lose_nothing(tmp_path):
    def rendered(name: str, render) -> Manifest:
        with RenderFarm(1, max_job_seconds=20) as farm:
            reference = replace(REFERENCE, samples=4)
            made = recipe(tmp_path / name, render=render, reference=reference, resolution=32, splits={"train": 3})
            return generation.generate(made, farm, lambda done, total: None)

    sabotaged = rendered("sabotaged", Sabotaged(tmp_path))
    assert len(list(tmp_path.glob("*.seen"))) == 2
    assert sabotaged.hash == rendered("undisturbed", cycles.render).hash


def make_slice(root: Path, index: int, count: int) -> None:
    with RenderFarm(1) as farm:
        generation.make(recipe(root), farm, lambda done, total: None, Slice(index, count))


def test_slices_made_apart_and_merged_equal_one_run(tmp_path, finished):
    for index in (2, 0, 1):
        make_slice(tmp_path / f"machine{index}", index, 3)
    here = tmp_path / "machine0"
    with pytest.raises(ShardError, match=r"4 of 6 shards are not finished, first train-00001\.tar.*copy them here"):
        generation.merge(recipe(here))
    assert status(recipe(here)).slices(3) == (1, 2)
    for index in (1, 2):
        for path in (tmp_path / f"machine{index}").glob("*-*.*"):
            shutil.copy(path, here)
    assert status(recipe(here)).is_complete
    assert generation.merge(recipe(here)).hash == finished.hash
    assert hashes(here) == hashes(finished.root)


def test_two_processes_do_not_make_the_same_slice(tmp_path):
    with FileLock(tmp_path / ".slice-1-of-3.lock"):
        with pytest.raises(UserError, match="another process is making slice 1 of 3"):
            make_slice(tmp_path, 1, 3)
        make_slice(tmp_path, 2, 3)
    make_slice(tmp_path, 1, 3)
    assert not list(tmp_path.glob("*.lock"))


@pytest.mark.parametrize(("index", "count"), [(3, 3), (-1, 2), (0, 0)])
def test_a_slice_that_does_not_exist_is_refused(index, count):
    with pytest.raises(UserError, match=rf"slice\.index={index} of slice\.count={count}"):
        Slice(index, count)


def test_status_counts_what_waits_and_what_is_missing(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        make(tmp_path, progress=InterruptAfter(3))
    found = status(recipe(tmp_path))
    train = found.splits["train"]
    assert (train.finished_shards, train.shards, train.finished_scenes, train.scenes) == (1, 3, 2, 5)
    assert train.waiting_scenes >= 1
    assert found.splits["test"].missing == (5,)
    assert not found.is_complete and not found.is_merged


def test_verify_finds_nothing_wrong_with_a_good_data_set(finished):
    shards = []
    with RenderFarm(1) as farm:
        assert verify(finished.root, farm, lambda done, total: shards.append(done)) == []
    assert shards[-1] == 6


def test_verify_lists_all_that_is_broken(copied):
    entry = Manifest.load(copied).samples("train")[1]
    damaged = bytearray((copied / "train-00000.tar").read_bytes())
    damaged[entry.offset + entry.size // 2] ^= 1
    (copied / "train-00000.tar").write_bytes(damaged)
    (copied / "train-00001.tar").write_bytes((copied / "train-00001.tar").read_bytes()[:-1])
    (copied / "train_newviews-00000.json").write_text("{}")
    (copied / "test-00000.tar").unlink()
    with RenderFarm(1) as farm:
        problems = verify(copied, farm, lambda done, total: None)
    assert len(problems) == 4
    expected = (
        "test-00000.tar: the shard is missing",
        "train-00000.tar: sample train-000001",
        "train-00001.tar: truncated",
        "train_newviews-00000.json",
    )
    for problem, words in zip(problems, expected, strict=True):
        assert words in problem
        assert "launch/generate.py" in problem


@requires_blender
def test_two_tiny_scenes_with_blender(tmp_path):
    def rendered(name: str) -> Manifest:
        reference = replace(REFERENCE, samples=4)
        return make(tmp_path / name, render=cycles.render, reference=reference, resolution=32, splits={"train": 2})

    manifest = rendered("once")
    for sample in scenes(manifest, "train"):
        assert sample.images.shape == (2, 32, 32, 3)
        seen = np.stack([gbuffer.hit for gbuffer in sample.gbuffers])
        assert np.median(sample.images[seen]) > 0.01, "the light must reach the floor"
    assert rendered("again").hash == manifest.hash
