"""Edits of a scene: what changes, and what does not."""

import numpy as np
import pytest
from edited_scenes import scene

from rfpp.errors import SceneError
from rfpp.scene.packed import pack
from rfpp.scene.spec import SceneObject
from rfpp.viewer.edits import moved, power, quaternion, remade, replaced, shining, tint, turned
from rfpp.viewer.picked_colour import from_picker, to_picker


def item(name: str) -> SceneObject:
    return next(item for item in scene().objects if item.name == name)


def test_only_the_edited_object_is_another():
    before, peak = scene(), item("peak_1")
    after = replaced(before, moved(peak, translation=(0.1, 0.2, 0.3)))
    assert [a is b for a, b in zip(before.objects, after.objects, strict=True)] == [
        o.name != "peak_1" for o in before.objects
    ]
    assert after.cameras == before.cameras
    old, new = pack(before).triangles, pack(after).triangles
    there = old.object_index == [o.name for o in before.objects].index("peak_1")
    shift = np.subtract((0.1, 0.2, 0.3), peak.transform.translation)
    np.testing.assert_allclose(new.positions[there], old.positions[there] + shift, atol=1e-6)
    np.testing.assert_array_equal(new.positions[~there], old.positions[~there])


def test_a_new_colour_holds_for_all_faces():
    peak = item("peak_0")
    painted = SceneObject(**{**dict(peak), "face_material": np.random.default_rng(0).random((len(peak.mesh), 10))})
    red = remade(painted, diffuse=(0.7, 0.0, 0.0))
    assert red.face_material is None
    assert red.material.diffuse == (0.7, 0.0, 0.0) and red.material.specular == peak.material.specular


def test_power_and_colour_of_a_light_are_independent():
    lamp = shining(item("lamp"), 500.0, (1.0, 0.5, 0.25))
    assert lamp.material.emissive == (500.0, 250.0, 125.0)
    assert (power(lamp), tint(lamp)) == (500.0, (1.0, 0.5, 0.25))
    assert shining(lamp, 100.0, tint(lamp)).material.emissive == (100.0, 50.0, 25.0)
    assert shining(lamp, 100.0, (0.5, 0.25, 0.125)).material.emissive == (100.0, 50.0, 25.0)  # as bright in any shade
    assert not shining(lamp, 0.0, tint(lamp)).material.is_emissive


def test_bad_values_are_refused_by_name():
    with pytest.raises(SceneError, match="roughness"):
        remade(item("floor"), roughness=1.5)


def test_colours_come_back_from_the_picker():
    for picked in [(0, 0, 0), (255, 255, 255), (1, 2, 3), (10, 128, 200)]:
        assert to_picker(from_picker(picked)) == picked
    assert from_picker((188, 188, 188)) == pytest.approx((0.5,) * 3, abs=0.005)


@pytest.mark.parametrize("rotation", [(0, 0, 0), (30, 0, 0), (0, -50, 0), (0, 0, 170), (-120, 40, 75)])
def test_an_object_turned_by_handles_stands_as_they_do(rotation):
    peak = moved(item("peak_1"), rotation=rotation, scale=(1.0, 1.0, 1.0), translation=(0.0, 0.0, 0.0))
    again = moved(peak, rotation=turned(3 * quaternion(peak.transform)))
    np.testing.assert_allclose(
        *(pack(replaced(scene(), each)).triangles.positions for each in (again, peak)), atol=1e-5
    )
    w, *axis = quaternion(peak.transform)
    vertices = moved(peak, rotation=(0, 0, 0))
    before, after = (pack(replaced(scene(), each)).triangles for each in (vertices, peak))
    there = before.object_index == [o.name for o in scene().objects].index("peak_1")
    v = before.positions[there].reshape(-1, 3)
    t = 2 * np.cross(axis, v)  # v rotated by a unit quaternion
    np.testing.assert_allclose(after.positions[there].reshape(-1, 3), v + w * t + np.cross(axis, t), atol=1e-5)
