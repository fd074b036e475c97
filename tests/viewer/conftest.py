"""A viewer of a small scene, and a browser."""

import pytest
from browser import _chromium, browser  # noqa: F401
from edited_scenes import scene
from networks import checkpoint_info, network

from rfpp.imaging.tone_maps import SRGB, AgX
from rfpp.inference.renderer import Renderer
from rfpp.reference.cycles import CyclesSettings
from rfpp.viewer.server import Viewer


@pytest.fixture
def renderer():
    return Renderer(network(), checkpoint_info())


@pytest.fixture
def cycles():
    return CyclesSettings(4, 0.0, False, 2, 2, 2, 0.0, 0.0, True, 0.0, 0.0, 1.5, 0, 1)


@pytest.fixture
def viewer(renderer, cycles):
    tone_maps = {"srgb": SRGB, "agx": AgX}
    with Viewer(renderer, scene(), tone_maps, cycles, "127.0.0.1", 0, longer_side=64, moving_seconds=10) as made:
        yield made
