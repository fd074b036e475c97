"""Shard indices: offset, size and hash of every sample.

Indices and manifests may be untrusted: parsing rejects names outside the data set's folder.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from rfpp.files import is_plain_name


def _plain(name: str) -> str:
    if not is_plain_name(name):
        raise ValueError(f"{name!r} is not a plain name")
    return name


def _tar(name: str) -> str:
    if not name.endswith(".tar"):
        raise ValueError(f"{name!r} is not the name of a shard")
    return _plain(name)


PlainName = Annotated[str, AfterValidator(_plain)]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}\z")]
Count = Annotated[int, Field(ge=0, lt=2**63)]


class Record(BaseModel):
    """Base class of JSON files and their parts: immutable, without conversions and unknown keys."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid")


class SampleEntry(NamedTuple):
    """Position of a sample in its tar, its hash, and its contents.

    `scene_redraws` counts the scenes rejected before this one; `empty_views` and `unlit_views` count the cameras
    rejected because they saw too little surface or too little light.
    """

    key: PlainName
    offset: Count
    size: Count
    sha256: Sha256
    triangles: Count
    objects: Count
    scene_redraws: Count
    empty_views: Count
    unlit_views: Count


class Shard(Record):
    """One finished tar file."""

    file: Annotated[str, AfterValidator(_tar)]
    bytes: Count
    sha256: Sha256
    fingerprint: str

    @property
    def index_file(self) -> str:
        """Name of the shard's index."""
        return index_file(self.file)


class ShardIndex(Shard):
    """A shard with its samples in order; the content of its index file."""

    samples: tuple[SampleEntry, ...]

    @model_validator(mode="after")
    def _is_inside_its_shard(self) -> ShardIndex:
        for entry in self.samples:
            if entry.offset + entry.size > self.bytes:
                raise ValueError(f"sample {entry.key} ends beyond its shard")
        return self

    def to_bytes(self) -> bytes:
        """Return the content of the index file."""
        return to_json(self.model_dump())


class ListedShard(Shard):
    """A shard as a manifest lists it: with its number of samples, and size and hash of its index."""

    samples: Count
    index_bytes: Count
    index_sha256: Sha256

    @classmethod
    def of(cls, index: ShardIndex) -> ListedShard:
        text = index.to_bytes()
        return cls(
            **index.model_dump(exclude={"samples"}),
            samples=len(index.samples),
            index_bytes=len(text),
            index_sha256=hashlib.sha256(text).hexdigest(),
        )


def index_file(file: str) -> str:
    """Return the name of the index beside the shard `file`."""
    return Path(file).with_suffix(".json").name


def to_json(content: Any) -> bytes:
    """Return compact, sorted JSON: equal content gives equal bytes."""
    return json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False).encode() + b"\n"
