"""Path-traced references: from a process that need not load torch, in order, with the time that each took."""

import subprocess
import sys

import numpy as np
from edited_scenes import dimmed, scene
from marks import requires_blender

from rfpp.inference.references import path_traced
from rfpp.reference.cycles import CyclesSettings
from rfpp.scene.packed import pack


def test_what_a_worker_imports_is_free_of_torch():
    check = "import sys, rfpp.inference.references; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", check], check=False).returncode == 0


@requires_blender
def test_scenes_come_back_in_order_with_their_views_and_times():
    settings = CyclesSettings(4, 0.0, False, 2, 2, 2, 0.0, 0.0, True, 0.0, 0.0, 1.5, 0, 1)
    bright, dim = pack(scene()), pack(dimmed(scene())).views([0])
    (first, took), (second, _) = path_traced(iter([bright, dim]), (8, 12), settings)
    assert first.shape == (3, 8, 12, 3)
    assert second.shape == (1, 8, 12, 3)
    assert took > 0
    assert second[0].mean() < first[0].mean()
    assert np.isfinite(first).all()
