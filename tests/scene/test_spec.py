"""Validation of what a scene is made of."""

from __future__ import annotations

import numpy as np
import pytest

from rfpp.errors import SceneError
from rfpp.scene.mesh import Mesh
from rfpp.scene.spec import Camera, Material, Scene, SceneObject, Transform

TRIANGLE = Mesh(np.eye(3), np.array([[0, 1, 2]]))
GREY = {"diffuse": (0.5, 0.5, 0.5), "specular": (0.1, 0.1, 0.1), "roughness": 0.5}
VIEW = {"position": (0, -2, 0), "look_at": (0, 0, 0), "fov": 40}


def thing(name: str = "thing", **material: object) -> SceneObject:
    return SceneObject(name=name, mesh=TRIANGLE, material=Material(**GREY | material))


@pytest.mark.parametrize(
    ("model", "values", "message"),
    [
        (Material, GREY | {"diffuse": (0.5, 1.2, 0.5)}, r"material\.diffuse\.1: .*less than or equal to 1, not 1\.2"),
        (Material, GREY | {"diffuse": (0.5, -0.1, 0.5)}, r"material\.diffuse\.1: .*greater than or equal to 0"),
        (Material, GREY | {"specular": (0.5, 0.5, 2)}, r"material\.specular\.2: "),
        (Material, GREY | {"specular": (0.5, 0.5)}, r"material\.specular\.2: this key is missing"),
        (Material, GREY | {"specular": 0.5}, r"material\.specular: .*tuple"),
        (Material, GREY | {"roughness": 1.5}, r"material\.roughness: "),
        (Material, GREY | {"roughness": float("nan")}, r"material\.roughness: .*not nan"),
        (Material, GREY | {"emissive": (1, -1, 1)}, r"material\.emissive\.1: "),
        (Material, GREY | {"emissive": (1, float("inf"), 1)}, r"material\.emissive\.1: .*finite"),
        (Material, GREY | {"rand_tri_diffuse_seed": -1}, r"material\.rand_tri_diffuse_seed: "),
        (Material, GREY | {"random_diffuse_type": "per-vertex"}, r"material\.random_diffuse_type: .*'per-triangle'"),
        (Material, GREY | {"color": 1}, r"material\.color: unknown key"),
        (Material, {"diffuse": (0.5, 0.5, 0.5)}, r"material\.specular: this key is missing"),
        (Transform, {"rotation": (0, 0, float("nan"))}, r"transform\.rotation\.2: .*finite"),
        (Transform, {"scales": (1, 1, 1)}, r"transform\.scales: unknown key"),
        (Camera, VIEW | {"look_at": (0, -2, 0)}, r"camera: look_at equals position"),
        (Camera, VIEW | {"up": (0, 1, 0)}, r"camera: up is zero or parallel"),
        (Camera, VIEW | {"up": (0, 0, 0)}, r"camera: up is zero or parallel"),
        (Camera, VIEW | {"fov": 180}, r"camera\.fov: .*less than 180"),
        (Camera, VIEW | {"fov": 0}, r"camera\.fov: .*greater than 0"),
        (Scene, {"objects": ()}, r"scene: objects: the scene is empty"),
        (Scene, {"objects": (thing(), thing())}, r"scene: objects: the name 'thing' is used twice"),
    ],
)
def test_a_bad_value_is_one_line_naming_the_key(model: type, values: dict, message: str) -> None:
    with pytest.raises(SceneError, match=message) as caught:
        model(**values)
    assert "\n" not in str(caught.value)


def test_an_object_stands_where_its_mesh_is() -> None:
    np.testing.assert_array_equal(thing().world_mesh.vertices, TRIANGLE.vertices)


def test_a_scene_is_printed_in_one_line() -> None:
    scene = Scene(name="desk", objects=(thing(),), cameras=(Camera(**VIEW),))
    assert f"{scene}" == repr(scene) == "<Scene 'desk': 1 objects, 1 triangles, 1 cameras>"


def test_reflecting_more_than_arrives_is_a_warning_naming_the_object() -> None:
    with pytest.warns(UserWarning, match=r"^object 'mirror': diffuse \+ specular is 1\.1, above 1[^\n]*$"):
        thing("mirror", specular=(0.6, 0.6, 0.6))


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        ([[0, 0, 0]], np.empty((0, 3), dtype=int), "no faces"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2], [0, 1, 3]], r"face 1 .*0…2"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, -1]], "face 0"),
        ([[0, 0, 0], [1, float("nan"), 0], [0, 1, 0]], [[0, 1, 2]], "vertex 1 is NaN"),
    ],
)
def test_a_mesh_is_valid_by_construction(vertices: list, faces: list, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        Mesh(np.array(vertices), np.array(faces))
