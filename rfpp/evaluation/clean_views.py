"""Stored scenes with known light that is free of noise, for errors of what networks add to it."""

from __future__ import annotations

import io
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from rfpp.batch import RaggedBatch, SceneViews
from rfpp.gbuffer.first_hit import CHANNELS
from rfpp.inference.gbuffers import GBufferSource
from rfpp.model.film import PixelFilter
from rfpp.model.linear_decoder import KNOWN
from rfpp.model.view_decoder import means
from rfpp.scene.files import write_atomically
from rfpp.scene.packed import PackedScene
from rfpp.shards.stream import ShardSplit

#: Points along each side of a pixel, and samples of light at each.
POINTS, SAMPLES = 2, 32
#: What is kept in half precision: all but where things are, and which cells are seen.
_HALF = tuple(name for name in CHANNELS if name not in ("position", "normal", "diffuse_cells", "glossy_cells"))


@dataclass(frozen=True, eq=False)
class CleanScene:
    """All V views of a stored scene.

    Attributes:
        views: the scene; its G-buffers have POINTS² points a pixel, and the channels of `CHANNELS` in their order.
        known: [V, 3, H, W] its known light: first bounce and reflection of it, filtered as the reference is.
    """

    views: SceneViews
    known: Float[Tensor, "v 3 h w"]

    def batch(self, channels: tuple[str, ...]) -> RaggedBatch:
        """For a network that reads these; without the image, which has fewer pixels than there are points."""
        packed = RaggedBatch.pack([replace(self.views, image=None)])
        named = dict(zip(CHANNELS, packed.gbuffer.split(list(CHANNELS.values()), dim=2), strict=True))
        stacked = [packed.gbuffer[:, :, :0], *(named[name] for name in channels)]
        return replace(packed, gbuffer=torch.cat(stacked, dim=2), image=None)


def clean_scene(split: ShardSplit, index: int, folder: Path) -> CleanScene:
    """The scene at `index` of a split; its rays are cast once and kept in `folder`."""
    sample = split.read(index, None, ())
    file = folder / f"{split.manifest.hash}-{sample.key}.npz"
    scene = PackedScene(sample.key, sample.triangles, sample.c2w, sample.fov)
    height, width = sample.images.shape[1:3]
    source = GBufferSource(tuple(CHANNELS))
    cells = source.known_of_scene(sample.triangles, ("cells",))["cells"]
    if file.exists():
        with np.load(file, allow_pickle=False) as stored:
            gbuffer = np.concatenate([stored[name].astype(np.float32) for name in CHANNELS], axis=1)
    else:
        rays = source.of(scene, height, width, SAMPLES, POINTS)
        gbuffer = np.stack([rays(view) for view in range(len(sample.fov))])
        parts = np.split(gbuffer, np.cumsum(list(CHANNELS.values()))[:-1], axis=1)
        named = dict(zip(CHANNELS, parts, strict=True))
        _write(file, {name: x.astype(np.float16) if name in _HALF else x for name, x in named.items()})
    views = SceneViews(
        key=sample.key,
        triangles=sample.triangles,
        c2w=sample.c2w,
        fov=sample.fov,
        gbuffer=gbuffer,
        image=np.ascontiguousarray(sample.images.transpose(0, 3, 1, 2)),
        object_light=sample.object_light,
        cells=cells,
    )
    return CleanScene(views, _known(torch.from_numpy(gbuffer)))


def _known(gbuffer: Float[Tensor, "v c h w"]) -> Float[Tensor, "v 3 height width"]:
    named = dict(zip(CHANNELS, gbuffer.split(list(CHANNELS.values()), dim=1), strict=True))
    albedo, specular, diffuse, glossy, reflected = (named[name] for name in KNOWN)
    return PixelFilter(0.125)(means(albedo * diffuse + specular * (glossy + reflected), POINTS))


def _write(file: Path, arrays: dict[str, np.ndarray]) -> None:
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    write_atomically(file, stream.getvalue())
