import json
import os
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from fuzzing import attempt, fuzzed
from hypothesis import given
from hypothesis import strategies as st
from mutations import JSON_VALUES, altered, damaged, dumped
from safetensors.numpy import load as load_arrays
from safetensors.numpy import save as save_arrays
from stored_sample import stored_sample

from rfpp.errors import ShardError
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.index import ListedShard, SampleEntry, ShardIndex
from rfpp.shards.manifest import MANIFEST_FILE, Manifest
from rfpp.shards.sample import SceneSample, decode, encode
from rfpp.shards.store import FolderStore
from rfpp.shards.stored_shard import StoredShard
from rfpp.shards.tar import pack

pytestmark = pytest.mark.timeout(36_000)  # of thousands

MEMBERS = encode(stored_sample(resolution=8))
BLOCKS = pack("train-000001", MEMBERS)


def refused(read: Callable[[], SceneSample | Manifest | ShardIndex], kind: str = "samples") -> str | None:
    """The message of a ShardError, or None for what is whole."""
    with attempt(kind) as one:
        try:
            result = read()
        except ShardError as error:
            return str(error)
        if isinstance(result, SceneSample):
            require_whole(result)
        one.taken = True
    return None


def require_whole(sample: SceneSample) -> None:
    """Arrays that fit each other, which is what a batch is made from."""
    triangles = sample.triangles
    assert triangles.positions.shape == triangles.normals.shape == (len(triangles), 3, 3)
    assert triangles.material.shape == (len(triangles), 10)
    assert triangles.object_offsets[-1] == len(triangles)
    assert len(triangles.object_names) == triangles.num_objects
    assert sample.c2w.shape == (len(sample.fov), 4, 4)
    assert sample.images.shape[0] == len(sample.gbuffers) == len(sample.fov)


@fuzzed
@given(data=st.data())
def test_a_damaged_tar_gives_the_stored_sample_or_is_named(finished, tmp_path_factory, data: st.DataObject) -> None:
    """Read by hash, like in training."""
    folder = tmp_path_factory.getbasetemp() / "fuzzed_tar"
    folder.mkdir(exist_ok=True)
    for file in finished.root.iterdir():
        if not (folder / file.name).exists():
            os.link(file, folder / file.name)
    name = "train-00000.tar"
    content = data.draw(damaged((finished.root / name).read_bytes()))
    (folder / name).unlink()
    (folder / name).write_bytes(content)
    stored = ShardSplit(finished.root, "train")[0]
    refusal = refused(lambda: same(ShardSplit(folder, "train")[0], stored))
    assert refusal is None or name in refusal


def same(sample: SceneSample, stored: SceneSample) -> SceneSample:
    np.testing.assert_array_equal(sample.images, stored.images)
    return sample


@fuzzed
@given(damaged(BLOCKS))
def test_damage_that_the_hash_agrees_with_is_named(tmp_path_factory, content: bytes) -> None:
    """A shard that was damaged before it was listed."""
    path = Path(tmp_path_factory.getbasetemp()) / "train-00000.tar"
    path.write_bytes(content)
    digest = sha256(content).hexdigest()
    sizes = {"bytes": len(content), "samples": 1, "index_bytes": 0}
    listed = ListedShard(file=path.name, sha256=digest, fingerprint="", index_sha256=digest, **sizes)
    shard = StoredShard(listed, FolderStore(path.parent))
    entry = SampleEntry("train-000001", 0, len(content), digest, 1, 1, 0, 0, 0)
    descriptor = os.open(path, os.O_RDONLY)
    refusal = refused(lambda: decode(entry.key, shard.members(descriptor, entry)))
    os.close(descriptor)
    assert refusal is None or "train-000001" in refusal


@fuzzed
@given(st.sampled_from(sorted(MEMBERS)).flatmap(lambda name: st.tuples(st.just(name), damaged(MEMBERS[name]))))
def test_damaged_members_are_named(member: tuple[str, bytes]) -> None:
    name, content = member
    refusal = refused(lambda: decode("train-000001", {**MEMBERS, name: content}))
    assert refusal is None or "train-000001" in refusal


ARRAYS = {name: load_arrays(MEMBERS[name]) for name in ("geometry.safetensors", "cameras.safetensors")}


@fuzzed
@given(st.sampled_from([(m, a) for m, arrays in ARRAYS.items() for a in arrays]), st.data())
def test_arrays_that_do_not_fit_each_other_are_named(place: tuple[str, str], data: st.DataObject) -> None:
    member, name = place
    array = ARRAYS[member][name]
    changes = {
        "shorter": lambda: array[:-1], "longer": lambda: np.concatenate([array, array[-1:]]), "none": lambda: array[:0],
        "flat": lambda: array.reshape(-1), "negative": lambda: -array - 1, "deeper": lambda: array[None],
    }  # fmt: skip
    changed = changes[data.draw(st.sampled_from(sorted(changes)))]()
    content = save_arrays({**ARRAYS[member], name: np.ascontiguousarray(changed)})
    refusal = refused(lambda: decode("train-000001", {**MEMBERS, member: content}))
    assert refusal is None or "train-000001" in refusal


@fuzzed
@given(altered(json.loads(MEMBERS["meta.json"])) | JSON_VALUES)
def test_altered_meta_data_are_named(meta: object) -> None:
    refusal = refused(lambda: decode("train-000001", {**MEMBERS, "meta.json": dumped(meta)}))
    assert refusal is None or "train-000001" in refusal


@fuzzed
@given(data=st.data())
def test_an_altered_manifest_is_named(finished, tmp_path_factory, data: st.DataObject) -> None:
    content = json.loads((finished.root / MANIFEST_FILE).read_bytes())
    folder = tmp_path_factory.getbasetemp() / "fuzzed_manifest"
    folder.mkdir(exist_ok=True)
    (folder / MANIFEST_FILE).write_bytes(dumped(data.draw(altered(content))))
    refusal = refused(lambda: Manifest.load(folder), "manifests")
    assert refusal is None or MANIFEST_FILE in refusal


@fuzzed
@given(data=st.data())
def test_an_altered_index_is_named(finished, tmp_path_factory, data: st.DataObject) -> None:
    """The manifest has the hash of the altered index."""
    listed = finished.shards("train")[0].listed
    folder = tmp_path_factory.getbasetemp() / "fuzzed_index"
    folder.mkdir(exist_ok=True)
    if not (folder / listed.file).exists():
        os.link(finished.root / listed.file, folder / listed.file)
    content = dumped(data.draw(altered(json.loads((finished.root / listed.index_file).read_bytes()))))
    (folder / listed.index_file).write_bytes(content)
    manifest = json.loads((finished.root / MANIFEST_FILE).read_bytes())
    manifest["splits"] = {"train": [{**manifest["splits"]["train"][0], "index_sha256": sha256(content).hexdigest()}]}
    (folder / MANIFEST_FILE).write_bytes(dumped(manifest))

    def first() -> SceneSample | ShardIndex:
        split = ShardSplit(folder, "train")
        return split[0] if len(split) else split.manifest.shards("train")[0].index()

    refusal = refused(first, "indices")
    assert refusal is None or "train-00000" in refusal
