"""NumberedScenes: an animation with a scene file for every frame."""

from __future__ import annotations

import re
from pathlib import Path

from rfpp.errors import SceneError
from rfpp.inference.motion.frames import Frames, Load, Motion, with_cameras
from rfpp.scene.io.loading import load_scene


class NumberedScenes(Motion):
    """The scene files of a folder, ordered by the numbers at the end of their names; `scene` is the folder.

    `load_scene` fits most formats into the unit cube, frame by frame: use JSON for scenes that grow or move.
    """

    pattern: str  # of the file names, such as *.json

    @property
    def name(self) -> str:
        return "film"

    def frames_of(self, scene: Path, camera: int, load: Load = load_scene) -> Frames:
        if not scene.is_dir():
            raise SceneError(f"{scene}: is not a folder: give the folder that holds a scene file per frame")
        files = self._in_order(scene)
        return Frames(len(files), lambda number: with_cameras(load(files[number]), files[number], [camera]))

    def _in_order(self, folder: Path) -> list[Path]:
        numbered: dict[int, Path] = {}
        for file in sorted(folder.glob(self.pattern)):
            digits = re.search(r"(\d+)$", file.stem)
            if digits is None:
                raise SceneError(f"{file}: has no number at the end of its name: rename it, or narrow motion.pattern")
            other = numbered.setdefault(int(digits[0]), file)
            if other is not file:
                raise SceneError(f"{file}: has the same number as {other.name}: rename it, or narrow motion.pattern")
        if not numbered:
            raise SceneError(f"{folder}: holds no file like '{self.pattern}': set motion.pattern, as in '*.glb'")
        for number in range(min(numbered), max(numbered)):
            if number not in numbered:
                raise SceneError(f"{folder}: frame {number} is missing between others: add it or renumber them")
        return [numbered[number] for number in sorted(numbered)]
