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


def with_lights(power: float, color: tuple[float, float, float]) -> PackedScene:
    tinted = lamp(1).model_copy(update={"emissive": color})
    return view(changed(changed(scene(), "lamp", material=lamp(power)), "spot", material=tinted))


@pytest.fixture
def mixer(monkeypatch):
    """A mixer that counts rendered views in `mixer.rendered`."""
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


def test_mixtures_equal_new_renders_and_each_light_is_rendered_once(mixer):
    mixer.image(view(scene()), SIZE)
    assert mixer.rendered == 1
    for power, color in [(100, (700.0, 10.0, 0.0)), (9000, (1.0, 2.0, 3.0)), (0.1, (0.0, 0.0, 5000.0))]:
        changed_lights = with_lights(power, color)
        expected = fresh(changed_lights)
        np.testing.assert_allclose(mixer.image(changed_lights, SIZE), expected, rtol=1e-3, atol=1e-4 * expected.max())
        assert mixer.is_separated(changed_lights, SIZE)
    assert mixer.rendered == 1 + 2


@pytest.mark.parametrize(
    "other",
    [lambda: view(moved(scene())), lambda: view(scene(), 1), lambda: with_lights(3000, (0.0, 0.0, 0.0))],
    ids=["moved", "another camera", "a light put out"],
)
def test_other_changes_are_rendered_again(mixer, other):
    mixer.image(view(scene()), SIZE)
    mixer.image(with_lights(100, (1.0, 1.0, 1.0)), SIZE)
    before, packed = mixer.rendered, other()
    assert not mixer.is_separated(packed, SIZE)
    np.testing.assert_array_equal(mixer.image(packed, SIZE), fresh(packed))
    assert mixer.rendered == before + 1


def test_a_light_that_varies_over_its_triangles_is_not_mixed(mixer):
    def two_colored(power: float) -> PackedScene:
        rows = np.tile(np.float32([0.5, 0.5, 0.5, 0, 0, 0, 0.5, power, power, power]), (2, 1))
        rows[1, 7] *= 2
        return view(changed(scene(), "spot", mesh=FLOOR, face_material=rows))

    mixer.image(two_colored(1.0), SIZE)
    np.testing.assert_array_equal(mixer.image(two_colored(2.0), SIZE), fresh(two_colored(2.0)))
    assert not mixer.is_separated(two_colored(2.0), SIZE)
