"""Reading one or several data sets: by plain WebDataset, by wids and by index; damage is named."""

import json
import re
import tarfile
from pathlib import Path

import numpy as np
import pytest
import webdataset
import wids
from small_data import make

from rfpp.errors import ShardError
from rfpp.shards import dataset
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.manifest import Manifest
from rfpp.shards.sample import SCHEMA_VERSION, decode


def flip_byte(path: Path, offset: int) -> None:
    content = bytearray(path.read_bytes())
    content[offset] ^= 0xFF
    path.write_bytes(content)


def test_plain_webdataset_reads_the_same_samples(finished):
    urls = sorted(str(path) for path in finished.root.glob("train-*.tar"))
    plain = {}
    for sample in webdataset.WebDataset(urls, shardshuffle=False):
        members = {name: data for name, data in sample.items() if not name.startswith("__")}
        plain[sample["__key__"]] = decode(sample["__key__"], members)
    ours = ShardSplit(finished.root, "train")
    assert list(plain) == [ours.key(i) for i in range(len(ours))]
    for i in range(len(ours)):
        np.testing.assert_array_equal(plain[ours.key(i)].images, ours[i].images)
        np.testing.assert_array_equal(plain[ours.key(i)].gbuffers[1].depth, ours[i].gbuffers[1].depth)


def test_wids_reads_the_same_samples(finished, tmp_path):
    split, tars = ShardSplit(finished.root, "train"), sorted(finished.root.glob("train-*.tar"))
    counts = [len(json.loads(tar.with_suffix(".json").read_bytes())["samples"]) for tar in tars]
    listed = [{"url": str(tar), "nsamples": count} for tar, count in zip(tars, counts, strict=True)]
    read = wids.ShardListDataset(listed, cache_dir=str(tmp_path), keep=True, transformations=[])
    assert len(read) == len(split)
    for i in range(len(split)):
        members = {name[1:]: data.read() for name, data in read[i].items() if not name.startswith("__")}
        assert read[i]["__key__"] == split.key(i)
        np.testing.assert_array_equal(decode(split.key(i), members).images, split[i].images)


def test_the_documented_webdataset_example_reads_the_same_images(finished):
    page = Path(__file__).parents[2] / "docs" / "data.md"
    (recipe,) = re.findall(r"```python\n(.+?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    assert "rfpp" not in recipe
    (pattern,) = re.findall(r'"(data/shards/\S+)"', recipe)
    tars = sorted(str(path) for path in finished.root.glob("train-*.tar"))
    names = {}
    exec(recipe.replace(f'"{pattern}"', repr(tars)), names)
    read = {scene["key"]: scene for scene in names["scenes"]}
    ours = ShardSplit(finished.root, "train")
    assert read.keys() == {ours.key(i) for i in range(len(ours))}
    for i in range(len(ours)):
        np.testing.assert_array_equal(read[ours.key(i)]["image"], ours[i].images[0])
        np.testing.assert_array_equal(read[ours.key(i)]["positions"], ours[i].triangles.positions)


def test_tars_are_plain_and_carry_no_clock_or_owner(finished):
    with tarfile.open(finished.root / "train-00000.tar") as archive:
        members = archive.getmembers()
    assert [m.name for m in members[:3]] == [
        "train-000000.cameras.safetensors", "train-000000.geometry.safetensors", "train-000000.meta.json"
    ]  # fmt: skip
    assert len(members) == 2 * (3 + 2 * 4)
    assert {(m.mtime, m.uid, m.gid, m.uname) for m in members} == {(0, 0, 0, "")}


def test_open_files_are_bounded(finished, monkeypatch):
    monkeypatch.setattr(dataset, "_MAX_OPEN", 2)
    split = ShardSplit(finished.root, "train")
    for i in (0, 2, 4, 0, 2):
        split[i]
        assert len(split._open) <= 2


def test_a_flipped_byte_names_shard_key_and_remedy(copied):
    split = ShardSplit(copied, "train")
    entry = split.manifest.samples("train")[3]
    flip_byte(copied / "train-00001.tar", entry.offset + entry.size // 2)
    assert split[2].key == "train-000002"  # the sample before it is intact
    with pytest.raises(ShardError, match=r"train-00001\.tar.*train-000003.*sha256.*delete train-00001\.tar and train"):
        split[3]


def test_a_truncated_shard_is_refused_at_once(copied):
    path = copied / "train-00000.tar"
    path.write_bytes(path.read_bytes()[:-700])
    with pytest.raises(ShardError, match=r"train-00000\.tar.*truncated.*launch/generate\.py"):
        ShardSplit(copied, "train")
    assert len(ShardSplit(copied, "test")) == 2


def test_a_shard_truncated_while_in_use_is_noticed(copied):
    split = ShardSplit(copied, "train")
    split[0]
    path = copied / "train-00000.tar"
    with path.open("r+b") as file:
        file.truncate(path.stat().st_size // 2)
    with pytest.raises(ShardError, match=r"train-00000\.tar.*train-000001"):
        split[1]


def test_an_index_of_other_data_is_noticed(copied):
    path = copied / "train-00000.json"
    path.write_text(path.read_text().replace("train-000001", "train-000007"))
    split = ShardSplit(copied, "train")  # an index is read together with its shard
    assert split[2].key == "train-000002"
    with pytest.raises(ShardError, match=r"train-00000\.json: the index does not have the sha256 in the manifest"):
        split[0]


def test_a_missing_index_is_named(copied):
    (copied / "train-00001.json").unlink()
    split = ShardSplit(copied, "train")
    with pytest.raises(ShardError, match=r"train-00001\.json: the index cannot be read \(No such file.*delete train"):
        split[3]


@pytest.mark.parametrize("text", [f'{{"schema_version": {SCHEMA_VERSION}}}', "[]", "not json", '{"name": 3}'])
def test_a_broken_manifest_is_named(copied, text):
    (copied / "manifest.json").write_text(text)
    with pytest.raises(ShardError, match=r"manifest\.json.*not a data set manifest \(.+\): delete it"):
        ShardSplit(copied, "train")


def test_another_schema_version_is_refused(copied):
    path = copied / "manifest.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "schema_version": SCHEMA_VERSION + 1}))
    with pytest.raises(ShardError, match=f"schema version {SCHEMA_VERSION + 1}, this code reads {SCHEMA_VERSION}"):
        ShardSplit(copied, "train")


def test_no_data_and_no_such_split_say_what_to_do(finished, tmp_path):
    with pytest.raises(ShardError, match=r"no finished data set.*launch/generate\.py"):
        ShardSplit(tmp_path, "train")
    with pytest.raises(ShardError, match="no split 'holdout': choose from test, train, train_newviews"):
        ShardSplit(finished.root, "holdout")


@pytest.fixture(scope="module")
def roots(tmp_path_factory):
    folder = tmp_path_factory.mktemp("joined")
    return [make(folder / f"of{n}", splits={"train": n, "validation": 1}).root for n in (2, 3)]


def test_several_data_sets_are_concatenated(roots):
    joined, parts = ShardSplit(roots, "train"), [ShardSplit(root, "train") for root in roots]
    apart = [(part, index) for part in parts for index in range(len(part))]
    assert len(joined) == sum(joined.sizes) == 5
    for number, (part, index) in enumerate(apart):
        assert joined.key(number) == part.key(index)
        assert joined.triangles(number) == part.triangles(index)
        np.testing.assert_array_equal(joined[number].images, part[index].images)
    assert len(ShardSplit([roots[0], roots[0], roots[1]], "train")) == 7


def test_joined_data_sets_have_their_own_name_and_hash(roots):
    one, both, reversed_ = Manifest.load(roots[0]), Manifest.load(roots), Manifest.load(roots[::-1])
    assert both.counts["scenes"] == 7 and both.name == f"{one.name}+{Manifest.load(roots[1]).name}"
    assert len({one.hash, both.hash, reversed_.hash}) == 3


def test_images_of_different_sizes_are_refused(roots, tmp_path):
    large = make(tmp_path / "large", splits={"train": 1, "validation": 1}, resolution=32).root
    with pytest.raises(ShardError, match=r"images differ in size \(.*: 32²\)"):
        Manifest.load([roots[0], large])
    with pytest.raises(ShardError, match=r"datamodule\.source\.root names no data set"):
        Manifest.load([])
