"""What a motion is: scene file → frames, each a scene with one camera."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import Field

from rfpp.errors import UserError
from rfpp.scene.io.loading import load_scene
from rfpp.scene.packed import PackedScene, pack
from rfpp.scene.spec import Scene, Strict

#: What reads a scene file.
Load = Callable[[Path], Scene | PackedScene]


class Motion(Strict):
    """A kind of film. Its settings are checked when it is made; files are read by `frames_of`."""

    noun = "motion"

    @property
    @abstractmethod
    def name(self) -> str:
        """What the film is called after the scene, in file names."""

    @abstractmethod
    def frames_of(self, scene: Path, camera: int, load: Load = load_scene) -> Frames:
        """The frames, each made when it is asked for. Neighbours of which only the camera moves share their triangles.

        Args:
            scene: what `load_scene` reads, or what the class says.
            camera: which of the scene's cameras to start from or look through.
            load: what reads it.

        Raises:
            UserError: the scene or a file that describes the motion cannot be used; the message names it.
        """


class KeyedMotion(Motion):
    """A film from the first key of a file to the last.

    Attributes:
        file: YAML or JSON.
        fps: frames per second.
    """

    file: Path
    fps: Annotated[float, Field(gt=0, le=1000)]

    @property
    def name(self) -> str:
        return self.file.stem


@dataclass(frozen=True)
class Frames(Sequence):  # of PackedScene, said here: a type checker that knew would make a frame to look at it
    """So many frames, made by `at` each time they are asked for."""

    length: int
    at: Callable[[int], PackedScene]

    def __len__(self) -> int:
        return self.length

    def __getitem__(self, number: int) -> PackedScene:
        if not 0 <= number < self.length:
            raise IndexError(number)
        return self.at(number)


def frames_between(start: float | int, end: float | int, fps: float | int) -> int:
    """How many frames there are from `start` to `end` in seconds, with one at each end if they are a whole number."""
    return int((end - start) * fps + 1e-6) + 1


def with_cameras(scene: Scene | PackedScene, file: Path, wanted: Sequence[int] | None) -> PackedScene:
    """The scene of a file with only the wanted cameras, or all. Raises UserError when one does not exist."""
    packed = pack(scene)
    count = len(packed.fov)
    if not count:
        raise UserError(f"{file}: has no camera: add one to its `cameras`")
    if wanted is None:
        return packed
    if not wanted or min(wanted) < 0 or max(wanted) >= count:
        there = "camera 0" if count == 1 else f"cameras 0…{count - 1}"
        raise UserError(f"cameras={list(wanted)}: {file} has {there}: choose among them")
    return packed.views(wanted)
