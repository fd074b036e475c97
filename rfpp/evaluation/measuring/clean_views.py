"""Stored scenes with noise-free known light, for measuring what a network adds to it."""

from __future__ import annotations

import io
from dataclasses import dataclass, replace
from hashlib import blake2b
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from rfpp.batch import RaggedBatch, SceneViews
from rfpp.files import write_atomically
from rfpp.raycast.first_hit import CELL_CHANNELS, CHANNELS
from rfpp.inference.gbuffers import GBufferSource
from rfpp.model.linear_decoder import KNOWN
from rfpp.model.pixel_filter import PixelFilter
from rfpp.radiosity.sample_means import means
from rfpp.scene.packed import PackedScene
from rfpp.shards.dataset import ShardSplit

#: Points along each side of a pixel, and samples of light of each pixel.
POINTS, SAMPLES = 2, 128
#: The same for the light that references are compared with. A lamp in a mirror is smaller than a pixel and a hundred
#: times as bright as all around; what 2 × 2 points miss of it would count as light of further bounces.
FINE_POINTS, FINE_SAMPLES = 6, 144
#: Pixels in which a lamp glints are left out: those that know, in them or beside them, so many times the image's mean
#: from glossy lobes. References of some hundred samples do not know how bright they are.
GLINT = 4.0
#: Near that of the references.
_FILM = PixelFilter(0.125)
_FINELY = "known_finely"
#: What is kept in half precision: all but where things are, and which cells are seen.
_HALF = tuple(name for name in CHANNELS if name not in ("position", "normal", *CELL_CHANNELS))


@dataclass(frozen=True, eq=False)
class CleanScene:
    """All V views of a stored scene.

    Attributes:
        views: the scene; its G-buffers have POINTS² points a pixel, and the channels of `CHANNELS` in their order.
        known: [V, 3, H, W] its known light, first bounce and reflection of it, as these G-buffers have it: a part of
            every network's image.
        known_finely: [V, 3, H, W] the same of FINE_POINTS² points a pixel: a part of the reference.
        counted: [V, 1, H, W] 1 for pixels in which no lamp glints, 0 for others.
    """

    views: SceneViews
    known: Float[Tensor, "v 3 h w"]
    known_finely: Float[Tensor, "v 3 h w"]
    counted: Float[Tensor, "v 1 h w"]

    @property
    def reference(self) -> Float[Tensor, "v 3 h w"]:
        return torch.from_numpy(self.views.image)

    @property
    def to_add(self) -> Float[Tensor, "v 3 h w"]:
        """Further light: the reference minus known light, in pixels that count."""
        return self.counted * (self.reference - self.known_finely)

    def added_by(self, image: Float[Tensor, "v 3 h w"]) -> Float[Tensor, "v 3 h w"]:
        """A network's image minus its known light, in pixels that count."""
        return self.counted * (image - self.known)

    def batch(self, channels: tuple[str, ...]) -> RaggedBatch:
        """A batch for a network with these inputs, without the image, which has fewer pixels than points."""
        packed = RaggedBatch.pack([replace(self.views, image=None)])
        named = dict(zip(CHANNELS, packed.gbuffer.split(list(CHANNELS.values()), dim=2), strict=True))
        stacked = [packed.gbuffer[:, :, :0], *(named[name] for name in channels)]
        return replace(packed, gbuffer=torch.cat(stacked, dim=2), image=None)


def clean_scene(split: ShardSplit, index: int, folder: Path) -> CleanScene:
    """The scene at `index` of a split; its rays are cast once and cached in `folder` for all data sets with it."""
    sample = split.read(index, None, ())
    scene = PackedScene(sample.key, sample.triangles, sample.c2w, sample.fov)
    height, width = sample.images.shape[1:3]
    file = folder / f"{_digest(scene, height, width)}.npz"
    source = GBufferSource(tuple(CHANNELS))
    cells = source.known_of_scene(sample.triangles, ("cells",))["cells"]
    if file.exists():
        with np.load(file, allow_pickle=False) as stored:
            gbuffer = np.concatenate([stored[name].astype(np.float32) for name in CHANNELS], axis=1)
            finely = stored[_FINELY]
    else:
        rays = source.of(scene, height, width, SAMPLES, POINTS)
        gbuffer = np.stack([rays(view) for view in range(len(sample.fov))])
        parts = np.split(gbuffer, np.cumsum(list(CHANNELS.values()))[:-1], axis=1)
        named = dict(zip(CHANNELS, parts, strict=True))
        finely = known_finely(scene, height, width)
        kept = {name: x.astype(np.float16) if name in _HALF else x for name, x in named.items()}
        _write(file, kept | {_FINELY: finely})
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
    named = dict(zip(CHANNELS, torch.from_numpy(gbuffer).split(list(CHANNELS.values()), dim=1), strict=True))
    albedo, specular, diffuse, glossy, reflected = (named[name] for name in KNOWN)
    known = _FILM(means(albedo * diffuse + specular * (glossy + reflected), POINTS))
    diffuse, glossy = torch.from_numpy(finely)
    return CleanScene(views, known, diffuse + glossy, without_glints(glossy, torch.from_numpy(views.image)))


def without_glints(glossy: Float[Tensor, "v 3 h w"], image: Float[Tensor, "v 3 h w"]) -> Float[Tensor, "v 1 h w"]:
    """Mask: 1 for pixels without glinting lamps, 0 for others.

    Args:
        glossy: known light from glossy lobes.
    """
    usual = image.mean((1, 2, 3), keepdim=True)
    return (F.max_pool2d(glossy.mean(1, keepdim=True), 3, stride=1, padding=1) <= GLINT * usual).float()


def known_finely(scene: PackedScene, height: int, width: int) -> Float[np.ndarray, "2 v 3 h w"]:
    """Noise-free, antialiased known light of the diffuse and the glossy lobe."""
    rays, lobes = GBufferSource(KNOWN).of(scene, height, width, FINE_SAMPLES, FINE_POINTS), []
    for view in range(len(scene.fov)):
        channels = torch.from_numpy(rays(view)).split([CHANNELS[name] for name in KNOWN])
        albedo, specular, diffuse, glossy, reflected = channels
        lobes.append(_FILM(means(torch.stack([albedo * diffuse, specular * (glossy + reflected)]), FINE_POINTS)))
    return torch.stack(lobes, dim=1).numpy()


def _digest(scene: PackedScene, height: int, width: int) -> str:
    of = scene.triangles
    digest = blake2b(repr((height, width)).encode(), digest_size=16)
    for array in (of.positions, of.normals, of.material, of.object_offsets, scene.c2w, scene.fov):
        digest.update(np.ascontiguousarray(array))
    return digest.hexdigest()


def _write(file: Path, arrays: dict[str, np.ndarray]) -> None:
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    write_atomically(file, stream.getvalue())
