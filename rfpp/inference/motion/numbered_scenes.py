"""NumberedScenes: a film whose every frame is a scene file."""

from __future__ import annotations

import re
from pathlib import Path

from rfpp.errors import SceneError
from rfpp.inference.motion.frames import Frames, Load, Motion, with_cameras
from rfpp.scene.io.loading import load_scene


class NumberedScenes(Motion):
    """The scene files of a folder in the order of the numbers at the end of their names; `scene` is the folder.

    Each file is a scene by itself: what `load_scene` fits into the unit cube is fitted frame by frame, so that a film
    of growing or moving things is better given in a format that it takes as it is, such as JSON.

    Attributes:
        pattern: which of the folder's files are frames, as in `*.json`.
    """

    pattern: str

    @property
    def name(self) -> str:
        return "film"

    def frames_of(self, scene: Path, camera: int, load: Load = load_scene) -> Frames:
        if not scene.is_dir():
            raise SceneError(f"{scene}: is not a folder: give the one that holds a scene file for each frame")
        files = self._in_order(scene)
        return Frames(len(files), lambda number: with_cameras(load(files[number]), files[number], [camera]))

    def _in_order(self, folder: Path) -> list[Path]:
        numbered: dict[int, Path] = {}
        for file in sorted(folder.glob(self.pattern)):
            digits = re.search(r"(\d+)$", file.stem)
            if digits is None:
                raise SceneError(f"{file}: has no number at the end of its name: rename it, or narrow motion.pattern")
            number = int(digits[0])
            if number in numbered:
                raise SceneError(
                    f"{file}: has the same number as {numbered[number].name}: rename it, or narrow motion.pattern"
                )
            numbered[number] = file
        if not numbered:
            raise SceneError(f"{folder}: holds no file like '{self.pattern}': set motion.pattern, as in '*.glb'")
        for number in range(min(numbered), max(numbered)):
            if number not in numbered:
                raise SceneError(f"{folder}: frame {number} is missing between others: add it or renumber them")
        return [numbered[number] for number in sorted(numbered)]
