"""Motions of animations: turntable, swing, keyframes of camera and objects, numbered scenes."""

from rfpp.inference.motion.frames import Motion
from rfpp.inference.motion.keyframes import Keyframes
from rfpp.inference.motion.numbered_scenes import NumberedScenes
from rfpp.inference.motion.turntable import Swing, Turntable

__all__ = ["Keyframes", "Motion", "NumberedScenes", "Swing", "Turntable"]
