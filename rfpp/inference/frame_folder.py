"""The frames of a film as EXR files, each of which says what it was rendered from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import nn

from rfpp.imaging.exr import ImageFileError, compact, decode_exr, exr_attributes, read_exr, write_exr
from rfpp.scene.packed import PackedScene

#: Name in the file's header of the digest of everything the image depends on.
_ORIGIN = "rendered_from"


@dataclass(frozen=True, eq=False)
class Shot:
    """A frame to be rendered: its number, what to render, and the digest that its file will hold."""

    number: int
    scene: PackedScene
    origin: str


class FrameFolder:
    """A film's frames in a folder: 00000.exr, 00001.exr, …

    A frame whose file came from the same scene, camera, size and renderer is kept; any other is missing. So an
    interrupted film goes on where it was, and a changed one renders what changed.

    Args:
        folder: made when the first frame is written.
        renderer: digest of what makes images out of scenes, settings included.
    """

    def __init__(self, folder: Path, renderer: bytes):
        self.folder, self._renderer = folder, renderer

    def missing(self, frames: Sequence) -> Iterator[Shot]:
        """The frames that are still to be rendered, in order."""
        for number in range(len(frames)):
            scene = frames[number]
            origin = self._origin(scene)
            if not self._holds(number, origin):
                yield Shot(number, scene, origin)

    def write(self, image: Float[np.ndarray, "h w 3"], shot: Shot) -> None:
        """Raises UserError (full disk)."""
        write_exr(self._path(shot.number), {"RGB": compact(image)}, {_ORIGIN: shot.origin})

    def images(self, count: int) -> Iterator[Float[np.ndarray, "h w 3"]]:
        """Linear radiance of the first frames. Raises ImageFileError naming one that cannot be read."""
        return (read_exr(self._path(number))["RGB"].astype(np.float32) for number in range(count))

    def _path(self, number: int) -> Path:
        return self.folder / f"{number:05d}.exr"

    def _origin(self, scene: PackedScene) -> str:
        triangles = scene.triangles
        arrays = triangles.positions, triangles.normals, triangles.material, triangles.object_offsets
        return digest(self._renderer, *arrays, scene.c2w, scene.fov, *filter(_given, [scene.texture])).hex()

    def _holds(self, number: int, origin: str) -> bool:
        try:
            data = self._path(number).read_bytes()
            return exr_attributes(data).get(_ORIGIN) == origin and "RGB" in decode_exr(data)
        except (OSError, ImageFileError):
            return False


def digest(*parts: bytes | np.ndarray) -> bytes:
    """Of what each part holds and how long it is."""
    together = blake2b(digest_size=16)
    for part in parts:
        content = np.ascontiguousarray(part).tobytes() if isinstance(part, np.ndarray) else part
        together.update(len(content).to_bytes(8, "little") + content)
    return together.digest()


def weights_digest(network: nn.Module) -> bytes:
    """Of all its parameters and buffers."""
    state = sorted(network.state_dict().items())
    return digest(*(name.encode() + _bytes(tensor) for name, tensor in state))


def _bytes(tensor: torch.Tensor) -> bytes:
    return tensor.detach().cpu().contiguous().reshape(-1).view(torch.uint8).numpy().tobytes()


def _given(part: object) -> bool:
    return part is not None
