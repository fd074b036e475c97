"""Generation of data sets: splits, rejected views, resumption, and refusal to mix settings."""

import contextlib
import errno
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
from small_data import (
    ACCEPTANCE,
    SETTINGS,
    BoxFamily,
    Constant,
    InterruptAfter,
    Interrupting,
    hashes,
    make,
    recipe,
)

from rfpp.errors import ShardError, UserError
from rfpp.shards import writer
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.manifest import Manifest
from rfpp.shards.status import status


def scenes(manifest: Manifest, split: str) -> list:
    data = ShardSplit(manifest.root, split)
    return [data[i] for i in range(len(data))]


def test_counts_files_and_keys(finished):
    assert [shard.listed.samples for shard in finished.shards("train")] == [2, 2, 1]
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


def test_test_scenes_differ_from_training_scenes(finished):
    colors = {tuple(s.triangles.material[2]) for split in ("train", "test") for s in scenes(finished, split)}
    assert len(colors) == 7


def test_the_same_command_again_does_nothing(copied, finished):
    before = {path.name: path.stat().st_mtime_ns for path in copied.iterdir()}
    calls = []
    again = make(copied, render=Constant(np.nan), progress=lambda *counts: calls.append(counts))
    assert {path.name: path.stat().st_mtime_ns for path in copied.iterdir()} == before
    assert again.hash == finished.hash
    assert calls == [(10, 10)]


@pytest.mark.parametrize(("workers", "count"), [(0, 2), (2, 3)])  # the end of a shard; the middle of one
def test_a_resumed_run_equals_an_uninterrupted_one(tmp_path, finished, workers, count):
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


def test_waiting_samples_are_not_mixed_with_other_settings(tmp_path):
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
        with contextlib.suppress(ProcessLookupError):  # it has finished
            os.killpg(run.pid, signal.SIGKILL)
        run.wait()
        assert list(root.rglob("*.sample")) or list(root.glob("*.tar"))
    assert make(root).hash == finished.hash


def test_a_deleted_shard_is_regenerated(copied, finished):
    (copied / "train-00001.tar").unlink()
    (copied / "train-00001.json").unlink()
    assert make(copied).hash == finished.hash
    assert hashes(copied) == hashes(finished.root)


def test_a_split_can_grow(copied, finished):
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
        make(root, render=renderer, workers=1)
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


def test_empty_views_are_redrawn_and_counted(tmp_path):
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


def test_dark_scenes_are_redrawn_before_rendering_and_new_views_follow(tmp_path):
    manifest = make(tmp_path, BoxFamily(night=0.5), acceptance=replace(ACCEPTANCE, camera_attempts=2))
    train, newviews = scenes(manifest, "train"), scenes(manifest, "train_newviews")
    drawn = manifest.samples("train")
    assert sum(entry.unlit_views for entry in drawn) == 2 * 2 * sum(entry.scene_redraws for entry in drawn) > 0
    assert any(e.scene_redraws for e in manifest.samples("train_newviews"))
    assert all(sample.triangles.material[-1, 7] == 3000 for sample in train + newviews)
    for seen, again in zip(train[:3], newviews, strict=True):
        np.testing.assert_array_equal(seen.triangles.positions, again.triangles.positions)


@pytest.mark.parametrize("family", [BoxFamily(looks_away=1.0), BoxFamily(night=1.0)])
def test_scenes_without_acceptable_views_fail_with_one_line(tmp_path, family):
    few = replace(ACCEPTANCE, camera_attempts=2, scene_attempts=2)
    with pytest.raises(ShardError, match=r"train-000000.*no acceptable views.*(8|0) too little light.*min_coverage"):
        make(tmp_path, family, acceptance=few, splits={"train": 1})


def test_radiance_beyond_half_precision_names_the_scene(tmp_path):
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


def test_a_data_set_is_resumed_after_its_code_has_moved(tmp_path):
    make(tmp_path, groups={"scene": {"_target_": "rfpp.scene.sampler.Boxes"}}, splits={"train": 2})
    [shard] = tmp_path.glob("train*.tar")
    written = shard.stat().st_mtime_ns
    moved = {"scene": {"_target_": "rfpp.scene.sampling.family.Boxes"}}
    assert make(tmp_path, groups=moved, splits={"train": 4}).counts["scenes"] == 4
    assert shard.stat().st_mtime_ns == written
    with pytest.raises(ShardError, match=r"scene\._target_ \(Boxes there, Spheres now\)"):
        make(tmp_path, groups={"scene": {"_target_": "rfpp.scene.sampling.family.Spheres"}}, splits={"train": 4})


def test_a_full_disk_names_the_shard_and_keeps_finished_ones(tmp_path, finished, monkeypatch):
    def full_after_first(descriptor: int) -> None:
        is_sample = ".sample" in os.readlink(f"/proc/self/fd/{descriptor}")
        if (tmp_path / "train-00000.json").exists() and not is_sample:
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


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": "../mine"}, r"data\.name is '\.\./mine': use letters"),
        ({"views": 0}, r"data\.views is 0"),
        ({"seed": -1}, r"data\.seed is -1"),
        ({"splits": {"train": 2, "holdout": 1}}, r"data\.splits\.holdout.*choose from train"),
        ({"splits": {"train": -2}}, r"data\.splits\.train is -2"),
        ({"splits": {"train": 2, "train_newviews": 3}}, "train_newviews is larger"),
        ({"splits": {"train": 0, "test": 0}}, r"data\.splits: all are 0"),
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


def test_the_number_of_views_must_match_the_family(tmp_path):
    with pytest.raises(UserError, match=r"^family\.cameras\.count=3: data\.views is 2"):
        make(tmp_path, BoxFamily(views=3))
