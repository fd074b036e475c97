"""Packing a scene into world-space triangles."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from rfpp.errors import SceneError
from rfpp.scene.mesh import Mesh, normalized
from rfpp.scene.spec import Material, Scene, SceneObject, Transform, rotation_matrix
from rfpp.scene.triangles import DIFFUSE, EMISSION, ROUGHNESS, SPECULAR, SceneTriangles

MATERIAL = Material(diffuse=(0.5, 0.4, 0.3), specular=(0.1, 0.1, 0.1), roughness=0.7)
SPHERE = trimesh.creation.icosphere(2)
SPHERE = Mesh(SPHERE.vertices, SPHERE.faces)
CORNER = Mesh(np.eye(3), np.array([[0, 1, 2]]))
AS_IS = {"normalize": False}


def pack(mesh: Mesh, material: Material = MATERIAL, **transform: object) -> SceneTriangles:
    item = SceneObject(name="thing", mesh=mesh, material=material, transform=Transform(**transform))
    return SceneTriangles.from_scene(Scene(objects=(item,)))


def outward(triangles: SceneTriangles) -> np.ndarray:
    """Cosine between each geometric normal and the direction from the center of the object."""
    a, b, c = np.moveaxis(triangles.positions.astype(np.float64), 1, 0)
    normals, away = np.cross(b - a, c - a), (a + b + c) / 3 - triangles.positions.mean(axis=(0, 1))
    return np.einsum("mc,mc->m", normals, away)


def test_rotation_is_about_world_x_then_y_then_z() -> None:
    np.testing.assert_allclose(rotation_matrix((90.0, 0.0, 0.0)) @ [0, 1, 0], [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(rotation_matrix((0.0, 90.0, 0.0)) @ [0, 0, 1], [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(rotation_matrix((0.0, 0.0, 90.0)) @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    # x turns +y to +z, y turns that to +x, z turns that to +y; in any other order it ends elsewhere.
    np.testing.assert_allclose(rotation_matrix((90.0, 90.0, 90.0)) @ [0, 1, 0], [0, 1, 0], atol=1e-12)


def test_rotation_then_scale_then_translation() -> None:
    packed = pack(CORNER, rotation=(0, 0, 90), scale=(2, 3, 4), translation=(10, 20, 30), **AS_IS)
    np.testing.assert_allclose(packed.positions[0], [[10, 23, 30], [8, 20, 30], [10, 20, 34]], atol=1e-5)


def test_normals_of_a_squeezed_sphere_are_those_of_the_ellipsoid() -> None:
    smooth = MATERIAL.model_copy(update={"smooth_shading": True})
    scale = np.array([0.5, 1.0, 0.8])
    packed = pack(SPHERE, smooth, scale=tuple(scale), **AS_IS)
    gradient = packed.positions / scale**2
    expected = gradient / np.linalg.norm(gradient, axis=-1, keepdims=True)
    assert np.einsum("mkc,mkc->mk", packed.normals, expected).min() > np.cos(np.radians(3))


@pytest.mark.parametrize("scale", [(1, 1, 1), (-1, 1, 1), (1, -2, 1), (-1, -1, 1), (-1, -1, -1)])
@pytest.mark.parametrize("smooth", [False, True])
def test_a_mirrored_object_still_faces_outwards(scale: tuple[float, float, float], smooth: bool) -> None:
    packed = pack(SPHERE, MATERIAL.model_copy(update={"smooth_shading": smooth}), scale=scale, **AS_IS)
    assert (outward(packed) > 0).all()
    assert np.einsum("mkc,mkc->mk", packed.normals, packed.positions).min() > 0


def test_objects_stay_apart_in_order() -> None:
    light = Material(diffuse=(1, 1, 1), specular=(0, 0, 0), roughness=1, emissive=(0, 5, 0))
    scene = Scene(
        objects=(
            SceneObject(name="ball", mesh=SPHERE, material=MATERIAL),
            SceneObject(name="light", mesh=CORNER, material=light, transform=Transform(**AS_IS)),
        )
    )
    packed = SceneTriangles.from_scene(scene)
    assert packed.object_names == ("ball", "light")
    assert packed.num_objects == 2
    np.testing.assert_array_equal(packed.object_offsets, [0, len(SPHERE), len(SPHERE) + 1])
    np.testing.assert_array_equal(packed.object_index, [0] * len(SPHERE) + [1])
    np.testing.assert_array_equal(packed.is_emissive, packed.object_index == 1)
    np.testing.assert_allclose(packed.material[0, DIFFUSE], (0.5, 0.4, 0.3))
    np.testing.assert_allclose(packed.material[0, SPECULAR], 0.1)
    np.testing.assert_allclose(packed.material[0, ROUGHNESS], 0.7)
    np.testing.assert_allclose(packed.material[-1, EMISSION], (0, 5, 0))
    assert {packed.positions.dtype, packed.normals.dtype, packed.material.dtype} == {np.dtype(np.float32)}
    assert packed.object_offsets.dtype == np.int32


def test_what_a_scale_flattens_is_dropped_and_nothing_left_is_an_error() -> None:
    box = trimesh.creation.box()
    flat = pack(Mesh(box.vertices, box.faces), scale=(1, 1, 0), **AS_IS)
    assert len(flat) == 4, "only top and bottom keep an area"
    with pytest.raises(SceneError, match="object 'thing': every triangle has zero area"):
        pack(SPHERE, scale=(1, 0, 0))


def colored(seed: int | None, kind: str = "per-triangle", top: float = 0.4, smooth: bool = True) -> np.ndarray:
    box = trimesh.creation.box().subdivide()
    material = Material(
        diffuse=(0.5, 0.5, 0.5), specular=(0, 0, 0), roughness=1, smooth_shading=smooth,
        rand_tri_diffuse_seed=seed, random_diffuse_max=top, random_diffuse_type=kind,
    )  # fmt: skip
    return pack(Mesh(box.vertices, box.faces), material).material[:, DIFFUSE]


def test_random_colors_are_eight_bit_below_their_maximum_and_repeatable() -> None:
    colors = colored(seed=0)
    np.testing.assert_array_equal(colors, colored(seed=0))
    assert not np.array_equal(colors, colored(seed=1))
    np.testing.assert_allclose(colors * 255, np.round(colors * 255), atol=1e-4)
    assert colors.max() * 255 < 256 * 0.4
    assert len(np.unique(colors, axis=0)) == 48
    assert (colored(seed=0, top=0.0) == 0).all()


def test_seed_zero_is_a_seed_and_none_is_not() -> None:
    assert not np.allclose(colored(seed=0), 0.5)
    np.testing.assert_allclose(colored(seed=None), 0.5)


def test_world_meshes_are_computed_once_and_follow_changes(monkeypatch) -> None:
    item = SceneObject(name="ball", mesh=SPHERE, material=MATERIAL, transform=Transform(normalize=True))
    computed = []
    monkeypatch.setattr("rfpp.scene.spec.normalized", lambda mesh: computed.append(mesh) or normalized(mesh))
    scene = Scene(objects=(item,))
    first, again = (SceneTriangles.from_scene(scene).positions for _ in range(2))
    assert len(computed) == 1
    np.testing.assert_array_equal(first, again)
    moved = item.model_copy(update={"transform": Transform(translation=(0, 0, 1), normalize=True)})
    np.testing.assert_allclose(moved.world_mesh.vertices, np.add(item.world_mesh.vertices, [0, 0, 1]), atol=1e-6)
    assert SceneObject(**dict(item)).world_mesh is not item.world_mesh
