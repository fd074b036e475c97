"""The interface of motions: scene file → frames, each a scene with one camera."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from rfpp.errors import UserError
from rfpp.scene.io.loading import load_scene
from rfpp.scene.packed import PackedScene, pack
from rfpp.scene.spec import Scene, Strict

#: Function that reads a scene file.
Load = Callable[[Path], Scene | PackedScene]


class Motion(Strict):
    """A kind of animation. Construction checks its settings; `frames_of` reads files."""

    noun = "motion"

    @property
    @abstractmethod
    def name(self) -> str:
        """Suffix of the animation's file name."""

    @abstractmethod
    def frames_of(self, scene: Path, camera: int, load: Load = load_scene) -> Frames:
        """Return the frames of a scene file; neighbors between which only the camera moves share their triangles.

        `camera` is the number of the camera to use or to start from, `load` reads a scene file. Raises UserError naming
        an invalid file.
        """


@dataclass(frozen=True)
class Frames(Sequence):  # without [PackedScene], for which beartype would create a frame to check it
    """A sequence of frames, each created on access."""

    length: int
    create: Callable[[int], PackedScene]

    def __len__(self) -> int:
        return self.length

    def __getitem__(self, number: int) -> PackedScene:
        if not 0 <= number < self.length:
            raise IndexError(number)
        return self.create(number)


def with_cameras(scene: Scene | PackedScene, file: Path, cameras: Sequence[int] | None) -> PackedScene:
    """Return the scene of a file with some of its cameras, or all. Raises UserError if one does not exist."""
    packed = pack(scene)
    count = len(packed.fov)
    if not count:
        raise UserError(f"{file}: has no camera: add one to its `cameras`")
    if cameras is None:
        return packed
    if not cameras or min(cameras) < 0 or max(cameras) >= count:
        existing = "camera 0" if count == 1 else f"cameras 0…{count - 1}"
        raise UserError(f"cameras={list(cameras)}: {file} has {existing}: choose among them")
    return packed.views(cameras)
