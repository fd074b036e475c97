"""The motions of films: turntable, camera path, keyframes, numbered scenes."""

from rfpp.inference.motion.camera_path import CameraPath
from rfpp.inference.motion.frames import Motion
from rfpp.inference.motion.keyframes import Keyframes
from rfpp.inference.motion.numbered_scenes import NumberedScenes
from rfpp.inference.motion.turntable import Swing, Turntable

__all__ = ["CameraPath", "Keyframes", "Motion", "NumberedScenes", "Swing", "Turntable"]
