"""Films: from a scene file to the frames of a motion. A class for each kind, named in conf/render/motion/*.yaml."""

from rfpp.inference.motion.camera_path import CameraPath
from rfpp.inference.motion.frames import Motion
from rfpp.inference.motion.keyframes import Keyframes
from rfpp.inference.motion.numbered_scenes import NumberedScenes
from rfpp.inference.motion.turntable import Swing, Turntable

__all__ = ["CameraPath", "Keyframes", "Motion", "NumberedScenes", "Swing", "Turntable"]
