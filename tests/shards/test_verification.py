"""Verification of a data set: all defects are listed."""

import hashlib
import json

from small_data import InProcess

from rfpp.reference.farm import RenderFarm
from rfpp.shards.manifest import Manifest
from rfpp.shards.verification import verify


def test_an_intact_data_set_has_no_defects(finished):
    shards = []
    with RenderFarm(1) as farm:
        assert verify(finished.root, farm, lambda done, total: shards.append(done)) == []
    assert shards[-1] == 6


def test_all_defects_are_listed(copied):
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


def test_an_incomplete_index_is_found_although_all_hashes_match(copied):
    index = copied / "train-00000.json"
    content = json.loads(index.read_text())
    content["samples"] = content["samples"][:-1]
    index.write_text(json.dumps(content))
    manifest = json.loads((copied / "manifest.json").read_text())
    listed = manifest["splits"]["train"][0]
    listed["index_sha256"] = hashlib.sha256(index.read_bytes()).hexdigest()
    (copied / "manifest.json").write_text(json.dumps(manifest))
    (problem,) = verify(copied, InProcess(), lambda done, total: None)
    assert f"train-00000.json: lists 1 samples, the manifest says {listed['samples']}" in problem
    listed["samples"] -= 1  # the manifest agrees
    (copied / "manifest.json").write_text(json.dumps(manifest))
    (problem,) = verify(copied, InProcess(), lambda done, total: None)
    assert "train-00000.tar: its index does not list all samples" in problem
