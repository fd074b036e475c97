"""What is brought without surroundings stands on something, and nothing else gets it."""

import warnings

import numpy as np
import pytest
import trimesh
from known_scenes import look_at

from rfpp.raycast.raycast import RayCaster
from rfpp.scene.io.loading import load_scene
from rfpp.scene.packed import pack

PANELS = {"floor", "back_wall", "left_wall"}


def loaded(path, **how):
    """The scene and the sentences that told what was done."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        scene = load_scene(path, **how)
    return scene, [str(warning.message) for warning in told]


def names(scene):
    return {item.name for item in scene.objects}


@pytest.fixture
def chair(tmp_path):
    """A seat, a back and a leg: nothing but itself."""
    pieces = [((1, 1, 0.1), (0, 0, 0)), ((0.1, 1, 1), (-0.45, 0, 0.55)), ((0.1, 0.1, 1), (0, 0, -0.55))]
    boxes = [trimesh.creation.box(size, trimesh.transformations.translation_matrix(at)) for size, at in pieces]
    trimesh.util.concatenate(boxes).export(tmp_path / "chair.stl")
    return tmp_path / "chair.stl"


@pytest.mark.parametrize(
    ("how", "added"), [({}, {"floor"}), ({"backdrop": "corner"}, PANELS), ({"backdrop": "none"}, set())]
)
def test_a_lone_object_gets_the_backdrop_that_is_asked_for(chair, how, added):
    scene, told = loaded(chair, **how)
    assert names(scene) & PANELS == added
    assert any("no surroundings" in line for line in told) == bool(added)


def test_it_stands_on_the_floor_and_the_camera_looks_at_it_as_before(chair):
    alone, on_floor = loaded(chair, backdrop="none")[0], loaded(chair)[0]
    assert on_floor.cameras == alone.cameras
    corners = {
        name: triangles.positions[triangles.object_index == number].reshape(-1, 3)
        for triangles in [pack(on_floor).triangles]
        for number, name in enumerate(triangles.object_names)
    }
    floor = corners.pop("floor")
    standing = np.concatenate([c for name, c in corners.items() if "light" not in name])
    assert 0 < standing[:, 2].min() - floor[:, 2].max() < 0.01
    assert (floor[:, :2].min(axis=0) < standing[:, :2].min(axis=0)).all()
    assert (floor[:, :2].max(axis=0) > standing[:, :2].max(axis=0)).all()


def test_the_walls_of_a_corner_are_behind_the_object(chair):
    scene = pack(loaded(chair, backdrop="corner")[0])
    caster = RayCaster(scene.triangles.positions[~scene.triangles.is_emissive])
    eye = scene.c2w[0, :3, 3]
    ways = np.array([(-0.3, 0.7, 0.1), (-0.8, -0.1, 0.1), (0, 0, -0.45)]) - eye
    seen = caster.cast(np.tile(eye, (3, 1)), ways / np.linalg.norm(ways, axis=1, keepdims=True))
    assert (seen.triangle >= 0).all()
    toward_object = caster.cast(eye[None], (-eye / np.linalg.norm(eye))[None])
    assert toward_object.distance[0] < np.linalg.norm(eye)  # no wall is in the way


def test_a_room_keeps_its_own_floor(tmp_path):
    floor = trimesh.Trimesh([[-2, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0]], [[0, 1, 2], [0, 2, 3]])
    box = trimesh.creation.box((1, 1, 1), trimesh.transformations.translation_matrix((0, 0, 0.5)))
    trimesh.util.concatenate([floor, box]).export(tmp_path / "room.stl")
    scene, told = loaded(tmp_path / "room.stl")
    assert not names(scene) & PANELS
    assert not any("no surroundings" in line for line in told)


def test_a_file_with_a_camera_has_surroundings(tmp_path, chair):
    scene = trimesh.Scene(trimesh.load_mesh(chair))
    scene.camera_transform = look_at((0, -3, 0))
    scene.export(tmp_path / "seen.glb")
    seen, told = loaded(tmp_path / "seen.glb")
    assert not any("has no camera" in line for line in told)
    assert not names(seen) & PANELS
