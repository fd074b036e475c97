"""Edits of a scene: the parts that change, and those that do not."""

import numpy as np
import pytest
from edited_scenes import scene

from rfpp.scene.packed import pack
from rfpp.scene.spec import SceneObject
from rfpp.viewer.edits import (
    power,
    quaternion,
    rotation,
    tint,
    with_light,
    with_material,
    with_object,
    with_transform,
)


def item(name: str) -> SceneObject:
    return next(item for item in scene().objects if item.name == name)


def test_an_edit_changes_one_object():
    before, peak = scene(), item("peak_1")
    after = with_object(before, with_transform(peak, translation=(0.1, 0.2, 0.3)))
    assert after.cameras == before.cameras
    old, new = pack(before).triangles, pack(after).triangles
    of_peak = old.object_index == old.object_names.index("peak_1")
    shift = np.subtract((0.1, 0.2, 0.3), peak.transform.translation)
    np.testing.assert_allclose(new.positions[of_peak], old.positions[of_peak] + shift, atol=1e-6)
    np.testing.assert_array_equal(new.positions[~of_peak], old.positions[~of_peak])


def test_a_new_color_applies_to_all_faces():
    peak = item("peak_0")
    rows = np.random.default_rng(0).random((len(peak.mesh), 10))
    painted = SceneObject(name="peak_0", mesh=peak.mesh, material=peak.material, face_material=rows)
    red = with_material(painted, diffuse=(0.7, 0.0, 0.0))
    assert red.face_material is None
    assert red.material.diffuse == (0.7, 0.0, 0.0) and red.material.specular == peak.material.specular


def test_power_and_color_of_a_light_are_independent():
    lamp = with_light(item("lamp"), 500.0, (1.0, 0.5, 0.25))
    assert lamp.material.emissive == (500.0, 250.0, 125.0)
    assert (power(lamp), tint(lamp)) == (500.0, (1.0, 0.5, 0.25))
    assert with_light(lamp, 100.0, tint(lamp)).material.emissive == (100.0, 50.0, 25.0)
    assert with_light(lamp, 100.0, (0.5, 0.25, 0.125)).material.emissive == (100.0, 50.0, 25.0)
    assert not with_light(lamp, 0.0, tint(lamp)).material.is_emissive


@pytest.mark.parametrize("angles", [(0, 0, 0), (30, 0, 0), (0, -50, 0), (0, 0, 170), (-120, 40, 75)])
def test_quaternions_of_the_gizmo_are_rotations_of_the_object(angles):
    plain = with_transform(item("peak_1"), scale=(1.0, 1.0, 1.0), translation=(0.0, 0.0, 0.0))
    turned = with_transform(plain, rotation=angles)
    again = with_transform(plain, rotation=rotation(3 * quaternion(turned.transform)))
    before, after, twice = (pack(with_object(scene(), each)).triangles for each in (plain, turned, again))
    np.testing.assert_allclose(twice.positions, after.positions, atol=1e-5)
    of_peak = before.object_index == before.object_names.index("peak_1")
    w, *axis = quaternion(turned.transform)
    v = before.positions[of_peak].reshape(-1, 3)
    t = 2 * np.cross(axis, v)  # rotation of v by a unit quaternion
    np.testing.assert_allclose(after.positions[of_peak].reshape(-1, 3), v + w * t + np.cross(axis, t), atol=1e-5)
