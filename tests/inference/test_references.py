"""Path-traced references: in order, with times, and from a process without torch."""

import subprocess
import sys

import numpy as np
from edited_scenes import dimmed, scene
from marks import requires_blender

from rfpp.inference.references import path_traced
from rfpp.reference.cycles import CyclesSettings
from rfpp.scene.packed import pack


def test_a_worker_does_not_import_torch():
    check = "import sys, rfpp.inference.references; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", check], check=False).returncode == 0


@requires_blender
def test_scenes_are_returned_in_order_with_their_times():
    settings = CyclesSettings(4, 0.0, False, 2, 2, 2, 0.0, 0.0, True, 0.0, 0.0, 1.5, 0, 1)
    bright, dim = pack(scene()), pack(dimmed(scene())).views([0])
    (first, took), (second, _) = path_traced(iter([bright, dim]), (8, 12), settings)
    assert first.shape == (3, 8, 12, 3)
    assert second.shape == (1, 8, 12, 3)
    assert took > 0
    assert second[0].mean() < first[0].mean()
    assert np.isfinite(first).all()
