"""Lights that are dimmed and coloured after one rendering of each: as if the scene had been rendered again."""

import numpy as np
import pytest
from edited_scenes import changed, lamp, moved, scene
from networks import checkpoint_info
from small_data import FLOOR

from rfpp import Renderer
from rfpp.inference.light_mixing import LightMixer
from rfpp.radiosity.radiosity import Radiosity
from rfpp.scene.packed import PackedScene, pack

SIZE = (16, 16)


def view(described, camera=0) -> PackedScene:
    return pack(described).seen_by([described.cameras[camera]])


def with_lights(power: float, colour: tuple[float, float, float]) -> PackedScene:
    tinted = lamp(1).model_copy(update={"emissive": colour})
    return view(changed(changed(scene(), "lamp", material=lamp(power)), "spot", material=tinted))


@pytest.fixture
def mixer(monkeypatch):
    """One that counts the views its renderer renders, in `mixer.rendered`."""
    renderer = Renderer(Radiosity(), checkpoint_info(resolution=SIZE))
    views = renderer.engine.views
    mixer = LightMixer(renderer)
    mixer.rendered = 0

    def counted(*args, **kwargs):
        mixer.rendered += 1
        return views(*args, **kwargs)

    monkeypatch.setattr(renderer.engine, "views", counted)
    return mixer


def fresh(packed: PackedScene) -> np.ndarray:
    return Renderer(Radiosity(), checkpoint_info(resolution=SIZE)).render(packed, SIZE)[0]


def test_every_setting_is_a_fresh_render_and_each_light_is_rendered_once(mixer):
    mixer.image(view(scene()), SIZE)
    assert mixer.rendered == 1
    for power, colour in [(100, (700.0, 10.0, 0.0)), (9000, (1.0, 2.0, 3.0)), (0.1, (0.0, 0.0, 5000.0))]:
        changed_lights = with_lights(power, colour)
        expected = fresh(changed_lights)
        np.testing.assert_allclose(mixer.image(changed_lights, SIZE), expected, rtol=1e-3, atol=1e-4 * expected.max())
        assert mixer.ready(changed_lights, SIZE)
    assert mixer.rendered == 1 + 2


def test_looking_around_renders_each_view_once(mixer):
    for camera in (0, 1, 0, 1):
        mixer.image(view(scene(), camera), SIZE)
    assert mixer.rendered == 4 and not mixer.ready(view(scene()), SIZE)


@pytest.mark.parametrize(
    "other",
    [lambda: view(moved(scene())), lambda: view(scene(), 1), lambda: with_lights(3000, (0.0, 0.0, 0.0))],
    ids=["moved", "another camera", "a light put out"],
)
def test_what_is_more_than_light_is_rendered_anew(mixer, other):
    mixer.image(view(scene()), SIZE)
    mixer.image(with_lights(100, (1.0, 1.0, 1.0)), SIZE)
    before, packed = mixer.rendered, other()
    assert not mixer.ready(packed, SIZE)
    np.testing.assert_array_equal(mixer.image(packed, SIZE), fresh(packed))
    assert mixer.rendered == before + 1


def test_a_light_of_several_colours_is_no_factor_of_a_white_one(mixer):
    def two_coloured(power: float) -> PackedScene:
        rows = np.tile(np.float32([0.5, 0.5, 0.5, 0, 0, 0, 0.5, power, power, power]), (2, 1))
        rows[1, 7] *= 2
        return view(changed(scene(), "spot", mesh=FLOOR, face_material=rows))

    mixer.image(two_coloured(1.0), SIZE)
    np.testing.assert_array_equal(mixer.image(two_coloured(2.0), SIZE), fresh(two_coloured(2.0)))
    assert not mixer.ready(two_coloured(2.0), SIZE)
