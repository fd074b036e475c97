"""Import RenderFormer's H5 training files as a data set.

Images come from the files; G-buffers and their direct light are computed. A sample is a pure function of its file; its
split follows from the names of all files.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import numpy as np

from rfpp.errors import SceneError, ShardError, UserError
from rfpp.scene.io.renderformer_h5 import image_shape, load_h5, load_images
from rfpp.shards.acceptance import EMPTY, UNLIT
from rfpp.shards.export import look_at
from rfpp.shards.job import DatasetSettings, SampleBlocks, SceneTask
from rfpp.shards.recipe import Recipe, fingerprint_of
from rfpp.shards.sample import SCHEMA_VERSION, SceneSample
from rfpp.shards.scene_rays import SceneRays


@dataclass(frozen=True)
class Import:
    """The *.h5 files of a folder, by split.

    Attributes:
        folder: folder of the files, which must agree in number of views and resolution.
        validation, test: shares of the files in these splits, drawn by a hash of the names; at least one file each
            unless the share is 0. The rest is for training.

    Raises:
        UserError: If the folder is missing or empty, or no file is left for training.
    """

    folder: Path
    validation: float | int
    test: float | int

    def __post_init__(self) -> None:
        if not self.folder.is_dir():
            raise UserError(f"{self.folder}: there is no such folder: give the folder with the H5 files to import")
        if not self.files:
            raise UserError(f"{self.folder}: holds no *.h5 files: give the folder with the H5 files to import")
        for split in ("validation", "test"):
            if not 0 <= getattr(self, split) <= 1:
                raise UserError(f"the share for {split} is {getattr(self, split)}: use 0 to 1")
        if not self.splits["train"]:
            raise UserError(f"{self.folder}: {len(self.files)} files, and none is left for training: lower the shares")

    @cached_property
    def files(self) -> tuple[Path, ...]:
        return tuple(sorted(self.folder.glob("*.h5")))

    @cached_property
    def splits(self) -> Mapping[str, tuple[Path, ...]]:
        """Split → its files, by name."""
        drawn = sorted(self.files, key=lambda path: hashlib.sha256(path.name.encode()).digest())
        ends = [0]
        for share in (self.validation, self.test):
            ends.append(ends[-1] + (max(1, round(share * len(drawn))) if share else 0))
        parts = {"train": drawn[ends[2] :], "validation": drawn[: ends[1]], "test": drawn[ends[1] : ends[2]]}
        return {split: tuple(sorted(part)) for split, part in parts.items()}

    def recipe(self, data: DatasetSettings) -> Recipe:
        """Return the recipe of a data set of these files.

        Args:
            data: Name, root, light_samples and scenes_per_shard; the files determine everything else.

        Raises:
            SceneError: If a file has no images, or images of another shape than the first.
        """
        views, resolution = self._common_shape()
        listing = "\n".join(f"{path.name} {path.stat().st_size}" for path in self.files)
        settings = {
            "schema_version": SCHEMA_VERSION,
            "data": {"resolution": resolution, "views": views, "light_samples": data.light_samples},
            "import": {
                "files": len(self.files),
                "names_and_sizes": hashlib.sha256(listing.encode()).hexdigest(),
                "validation": self.validation,
                "test": self.test,
            },
        }
        return Recipe(
            name=data.name,
            root=Path(data.root),
            splits={split: len(files) for split, files in self.splits.items()},
            views=views,
            scenes_per_shard=data.scenes_per_shard,
            settings=settings,
            job=ImportJob(self.folder, self.validation, self.test, data.light_samples, fingerprint_of(settings)),
        )

    def _common_shape(self) -> tuple[int, int]:
        """Return the number of views and the resolution of the images in all files."""
        first = image_shape(self.files[0])
        for path in self.files:
            views, height, width = image_shape(path)
            if height != width:
                raise SceneError(f"{path}: images of {width} x {height} pixels: training supports only square images")
            if (views, height, width) != first:
                raise SceneError(
                    f"{path}: {views} views of {height} x {width} pixels, where {self.files[0].name} has {first[0]} of "
                    f"{first[1]} x {first[2]}: move it to another folder"
                )
        return first[:2]


@dataclass(frozen=True)
class ImportJob:
    """Task that makes a sample of a file; picklable, and small because it is sent with each call."""

    folder: Path
    validation: float | int
    test: float | int
    light_samples: int
    fingerprint: str

    def __call__(self, task: SceneTask) -> SampleBlocks:
        """Raise SceneError naming the file if it is unreadable, textured, or beyond half precision."""
        path = _imported(self.folder, self.validation, self.test).splits[task.split][task.index]
        scene, images = load_h5(path), load_images(path)
        if scene.texture is not None:
            raise SceneError(
                f"{path}: texture: varies within triangles; samples hold one material per triangle: remove the file"
            )
        digest = hashlib.sha256(path.read_bytes())
        meta = {
            "family": "imported",
            "source": path.name,
            "source_sha256": digest.hexdigest(),
            "split": task.split,
            "index": task.index,
            "redraws": {"scene_redraws": 0, EMPTY: 0, UNLIT: 0},
            "settings": self.fingerprint,
            "cameras": [look_at(*view).model_dump(mode="json") for view in zip(scene.c2w, scene.fov, strict=True)],
        }
        seed = np.random.SeedSequence(int.from_bytes(digest.digest()))
        gbuffers = SceneRays(scene.triangles).gbuffers(scene.c2w, scene.fov, images.shape[1], self.light_samples, seed)
        try:
            return SampleBlocks.of(SceneSample(task.key, scene.triangles, scene.c2w, scene.fov, images, gbuffers, meta))
        except ShardError as error:
            raise SceneError(f"{path}: {error}") from None


#: Lists the folder once per worker, not once per file.
_imported = cache(Import)
