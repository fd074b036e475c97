"""CameraPath: a flight through a scene that stays as it is."""

from __future__ import annotations

from pathlib import Path

from rfpp.inference.motion.frames import Frames, KeyedMotion, Load, frames_between
from rfpp.inference.motion.key_files import CameraTrack, Entries, read_keys
from rfpp.scene.io.loading import load_scene
from rfpp.scene.packed import pack
from rfpp.scene.spec import Strict


class CameraPath(KeyedMotion):
    """The camera of a file, from its first key to its last; the scene's own cameras are not used.

        camera:
          - {time: 0, position: [0, -2, 0.6], look_at: [0, 0, 0], fov: 40}
          - {time: 2, position: [1.5, -1.2, 0.6], look_at: [0, 0, 0], fov: 30}

    Times are seconds, the rest is a camera of a scene file. Place and target run along splines through the keys.
    """

    def frames_of(self, scene: Path, camera: int, load: Load = load_scene) -> Frames:
        track = CameraTrack(read_keys(self.file, _CameraPathFile).camera, f"{self.file}: camera")
        still, start = pack(load(scene)), track.times[0]
        count = frames_between(start, track.times[-1], self.fps)
        return Frames(count, lambda number: still.seen_by([track.at(start + number / self.fps)]))


class _CameraPathFile(Strict):
    noun = ""

    camera: Entries
