"""RaggedBatch: the triangles of many scenes packed end to end, without padding and without truncation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from rfpp.scene.triangles import SceneTriangles
from rfpp.segments import Segments, on_device


@dataclass(frozen=True)
class SceneViews:
    """One scene seen by V cameras, before packing.

    Attributes:
        key: names the sample in messages and records.
        triangles: the whole scene.
        c2w: [V, 4, 4] camera-to-world.
        fov: [V] degrees, along the longer image side.
        gbuffer: [V, C, H, W] first-hit channels in camera space.
        image: [V, 3, H, W] linear radiance, where a reference exists.
        texture: [M, 13, P, P] where materials vary over triangles, see `rfpp.scene.texture`.
        token_light: [O, 8, K + 1, 3] mean irradiance of each object's surfaces that face an octant, after k bounces;
            NaN where there are none.
    """

    key: str
    triangles: SceneTriangles
    c2w: np.ndarray
    fov: np.ndarray
    gbuffer: np.ndarray
    image: np.ndarray | None = None
    texture: np.ndarray | None = None
    token_light: np.ndarray | None = None


def common_size(count: int, per_octave: int = 8) -> int:
    """Return `count` rounded up to one of eight sizes, or another power of two, between powers of two."""
    step = 1 << max(0, count.bit_length() - per_octave.bit_length())
    return -(-count // step) * step


#: Parts of a batch that live on a device.
_Movable = Tensor | Segments


@dataclass(frozen=True)
class RaggedBatch:
    """B scenes with V views each; triangles sorted by object, objects by scene.

    Attributes:
        positions, normals: [M, 3, 3] world-space corners and shading normals.
        material: [M, 10] diffuse 3, specular 3, roughness 1, emitted radiance 3 (linear).
        objects: O segments of the M triangles.
        scenes: B segments of the O objects.
        c2w, fov: [B, V, 4, 4], [B, V].
        gbuffer: [B, V, C, H, W].
        image: [B, V, 3, H, W] linear radiance, or None when rendering.
        texture: [M, 13, P, P] emission linear, or None where every triangle has one material.
        token_light: [8 O, K + 1, 3] light of object tokens, see `SceneViews`, or None.
        emitters: [E] the triangles that emit; on the host, so that pairing them with objects waits for no device.
    """

    positions: Float[Tensor, "m 3 3"]
    normals: Float[Tensor, "m 3 3"]
    material: Float[Tensor, "m 10"]
    objects: Segments
    scenes: Segments
    c2w: Float[Tensor, "b v 4 4"]
    fov: Float[Tensor, "b v"]
    gbuffer: Float[Tensor, "b v c h w"]
    image: Float[Tensor, "b v 3 h w"] | None
    keys: tuple[str, ...]
    emitters: Int[np.ndarray, " e"]
    texture: Float[Tensor, "m 13 p p"] | None = None
    token_light: Float[Tensor, "tokens k 3"] | None = None

    @classmethod
    def pack(cls, samples: Sequence[SceneViews]) -> RaggedBatch:
        """Pack scenes of any sizes; all must have the same number of views and the same resolution.

        Raises ValueError when only some of them are textured.
        """
        triangles = [s.triangles for s in samples]

        def packed(arrays: list[np.ndarray]) -> Tensor:
            return torch.from_numpy(np.concatenate(arrays).astype(np.float32, copy=False))

        def stacked(arrays: list[np.ndarray]) -> Tensor:
            return torch.from_numpy(np.stack(arrays).astype(np.float32, copy=False))

        textures = [s.texture for s in samples if s.texture is not None]
        if textures and len(textures) < len(samples):
            raise ValueError("textured scenes and others cannot share a batch")
        light = [s.token_light.reshape(-1, *s.token_light.shape[2:]) for s in samples if s.token_light is not None]
        with_images = all(s.image is not None for s in samples)
        objects = [t.num_objects for t in triangles]
        return cls(
            positions=packed([t.positions for t in triangles]),
            normals=packed([t.normals for t in triangles]),
            material=packed([t.material for t in triangles]),
            objects=Segments.from_lengths([b - a for t in triangles for a, b in pairwise(t.object_offsets.tolist())]),
            scenes=Segments.from_lengths(objects),
            c2w=stacked([s.c2w for s in samples]),
            fov=stacked([s.fov for s in samples]),
            gbuffer=stacked([s.gbuffer for s in samples]),
            image=stacked([s.image for s in samples]) if with_images else None,
            keys=tuple(s.key for s in samples),
            emitters=np.flatnonzero(np.concatenate([t.is_emissive for t in triangles])),
            texture=packed(textures) if textures else None,
            token_light=packed(light) if len(light) == len(samples) else None,
        )

    @property
    def num_views(self) -> int:
        """V, the views of each scene."""
        return self.c2w.shape[1]

    @property
    def resolution(self) -> tuple[int, int]:
        """(H, W) in pixels."""
        return self.gbuffer.shape[-2], self.gbuffer.shape[-1]

    @cached_property
    def log_emission(self) -> Float[Tensor, "m 3"]:
        """[M, 3] log10(1 + emitted radiance) per triangle; exactly zero where nothing is emitted."""
        return torch.log10(1 + self.material[:, 7:10])

    @cached_property
    def areas(self) -> Float[Tensor, " m"]:
        """[M] triangle areas in square world units."""
        a, b, c = self.positions.unbind(1)
        return 0.5 * torch.linalg.vector_norm(torch.linalg.cross(b - a, c - a), dim=-1)

    def normalized(self, exposure: Float[Tensor, " b"]) -> RaggedBatch:
        """Divide each scene's emission by its exposure. Images are unchanged."""
        per_triangle = exposure[self.scenes.index][self.objects.index]
        material = torch.cat([self.material[:, :7], self.material[:, 7:10] / per_triangle[:, None]], dim=-1)
        texture = self.texture
        if texture is not None:
            texture = torch.cat([texture[:, :10], texture[:, 10:] / per_triangle[:, None, None, None]], dim=1)
        light = self.token_light
        if light is not None:
            light = (
                light / exposure[self.scenes.index].repeat_interleave(len(light) // len(self.objects))[:, None, None]
            )
        return replace(self, material=material, texture=texture, token_light=light)

    def padded(self) -> RaggedBatch:
        """Return the batch with numbers of triangles and objects that recur from batch to batch.

        The added triangles are objects of one more scene, after the others, of which there is no view. Images, losses
        and gradients stay the same.
        """
        triangles, objects = len(self.positions), len(self.objects)
        more = common_size(objects + (common_size(triangles) > triangles), per_octave=4) - objects
        new = common_size(triangles + more) - triangles if more else 0
        per_object = [new // more + (number < new % more) for number in range(more)]
        corners = torch.eye(3).expand(new, 3, 3)  # with an area, for means over objects
        extra = {"positions": corners, "normals": corners, "material": torch.zeros(new, 10)}
        if self.texture is not None:
            extra["texture"] = torch.zeros(new, *self.texture.shape[1:])
        if self.token_light is not None:
            extra["token_light"] = torch.full((8 * more, *self.token_light.shape[1:]), torch.nan)
        lengths = [*self.objects.lengths, *per_object], [*self.scenes.lengths, more]
        of_objects, of_scenes = (Segments.from_lengths(n) for n in lengths)
        longest = 1 << (of_objects.longest - 1).bit_length()
        return replace(
            self,
            **{name: torch.cat([getattr(self, name), rows]) for name, rows in extra.items()},
            objects=replace(of_objects, longest=longest),
            scenes=replace(of_scenes, longest=len(of_objects)),
        )

    @property
    def shape(self) -> tuple[tuple[int, ...], ...]:
        """Every size that the work on a batch depends on."""
        bounds = (self.objects.longest, self.scenes.longest)
        return *(tuple(tensor.shape) for tensor in self.tensors()), bounds

    def tensors(self) -> list[Tensor]:
        """Return everything that is on the device."""
        parts = (getattr(self, field.name) for field in fields(self))
        return [part.offsets if isinstance(part, Segments) else part for part in parts if isinstance(part, _Movable)]

    def with_tensors(self, tensors: Sequence[Tensor]) -> RaggedBatch:
        """Return a batch of the same shape with other `tensors`, whose lengths the host does not know."""
        names = [field.name for field in fields(self) if isinstance(getattr(self, field.name), _Movable)]
        parts: dict[str, Any] = dict(zip(names, tensors, strict=True))
        for name in ("objects", "scenes"):
            parts[name] = replace(getattr(self, name), offsets=parts[name], host_lengths=None)
        return replace(self, **parts)

    def only(self, objects: Sequence[int]) -> RaggedBatch:
        """Return a scene of these objects alone, in this order."""
        starts = np.concatenate([[0], np.cumsum(self.objects.lengths)])
        rows = np.concatenate([np.arange(starts[number], starts[number + 1]) for number in objects])
        emitters = np.flatnonzero(np.isin(rows, self.emitters))
        rows = on_device(rows, self.positions.device)
        return replace(
            self,
            positions=self.positions[rows],
            normals=self.normals[rows],
            material=self.material[rows],
            objects=Segments.from_lengths([self.objects.lengths[number] for number in objects], rows.device),
            scenes=Segments.from_lengths([len(objects)], rows.device),
            emitters=emitters,
            texture=None if self.texture is None else self.texture[rows],
            token_light=None,
        )

    def object_chunks(self, objects: Sequence[int], triangles: int) -> Iterator[list[int]]:
        """Group consecutive objects up to a total of `triangles`; larger objects stand alone."""
        chunk, size = [], 0
        for number in objects:
            if chunk and size + self.objects.lengths[number] > triangles:
                yield chunk
                chunk, size = [], 0
            chunk.append(number)
            size += self.objects.lengths[number]
        if chunk:
            yield chunk

    def to(self, device: torch.device | str, **kwargs) -> RaggedBatch:
        moved = {}
        for field in fields(self):
            value = getattr(self, field.name)
            moved[field.name] = value.to(device, **kwargs) if isinstance(value, _Movable) else value
        return RaggedBatch(**moved)

    def pin_memory(self) -> RaggedBatch:
        pinned = {
            field.name: value.pin_memory()
            for field in fields(self)
            if isinstance(value := getattr(self, field.name), _Movable)
        }
        return replace(self, **pinned)
