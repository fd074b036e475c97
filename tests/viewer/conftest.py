"""A viewer of a small scene, and a browser."""

import functools

import pytest
from browser import _chromium, browser  # noqa: F401
from edited_scenes import scene
from networks import checkpoint_info, network

from rfpp.imaging.tone_maps import SRGB, AgX
from rfpp.inference.renderer import Renderer
from rfpp.reference.cycles import CyclesSettings
from rfpp.viewer.reference import PathTracer
from rfpp.viewer.server import Viewer

TONE_MAPS = {"srgb": SRGB, "agx": AgX}


@pytest.fixture
def renderer():
    return Renderer(network(), checkpoint_info())


@pytest.fixture
def tracer():
    made = PathTracer(_settings())
    yield made
    made.close()


@pytest.fixture
def viewer(renderer, tracer):
    with Viewer(renderer, scene(), TONE_MAPS, tracer, "127.0.0.1", 0, longer_side=64, moving_seconds=10) as made:
        yield made


@functools.cache
def _settings() -> CyclesSettings:
    from hydra.utils import instantiate

    from rfpp.commands import settings

    return instantiate(settings("reference", "reference_settings", "preview"), samples=4)
