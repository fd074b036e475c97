from dataclasses import fields, replace

import numpy as np
import pytest
from manifold3d import Manifold
from manifold3d import Mesh as ManifoldMesh
from scene_families import family, objects, scenes

from rfpp.errors import SceneError
from rfpp.scene.sampling.objects.procedural import ProceduralObjects
from rfpp.scene.sampling.open_region import OpenRegion
from rfpp.scene.sampling.placement import UprightPlacement
from rfpp.scene.spec import rotation_matrix
from rfpp.scene.triangles import SceneTriangles

PLACEMENT = family("quickstart").placement
PEBBLE = ProceduralObjects(["pebble"], pool=100, held_out=0.1, stretched=0.5, deformed=0.0).mesh(0, 50)
FLOOR = OpenRegion(np.array([[0.0, 0.0, 1.0]]), np.array([-0.4]))


def world_vertices(scene, kind):
    """[vertices of each object of a kind], in world space."""
    triangles = SceneTriangles.from_scene(scene)
    corners = np.split(triangles.positions, triangles.object_offsets[1:-1])
    return [c.reshape(-1, 3) for c, name in zip(corners, triangles.object_names, strict=True) if name.startswith(kind)]


def planes(scene):
    """(normal, offset) of each panel, from its world triangles alone."""
    for vertices in world_vertices(scene, "background"):
        a, b, c = vertices[:3].astype(np.float64)
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal)
        yield normal, normal @ a


@pytest.mark.parametrize(
    ("name", "count"), [("quickstart", 60), ("renderformer", 6), ("small_scale", 3), ("large_scale", 1)]
)
def test_objects_are_in_the_cube_in_front_of_the_panels_with_boxes_apart(name, count):
    for scene in scenes(name, count):
        vertices = world_vertices(scene, "object")
        assert np.abs(np.concatenate(vertices)).max() <= 0.5 + 1e-6
        for normal, offset in planes(scene):
            assert min((v @ normal).min() for v in vertices) > offset
        low, high = np.array([v.min(axis=0) for v in vertices]), np.array([v.max(axis=0) for v in vertices])
        apart = (low[:, None] > high[None] + 0.009).any(axis=2)
        assert (apart | apart.T | np.eye(len(vertices), dtype=bool)).all()


@pytest.mark.parametrize(("name", "count"), [("quickstart", 60), ("small_scale", 3)])
def test_no_two_meshes_intersect(name, count):
    for scene in scenes(name, count):
        solids = []
        for item in objects(scene, "object"):
            rotated = item.mesh.vertices @ rotation_matrix(item.transform.rotation).T
            vertices = (rotated * item.transform.scale + item.transform.translation).astype(np.float32)
            solids.append(Manifold(ManifoldMesh(vertices, item.mesh.faces.astype(np.uint32))))
        assert all(s.volume() > 0 for s in solids)
        for i, solid in enumerate(solids):
            assert all((solid ^ other).volume() == 0 for other in solids[:i])


def test_resting_objects_touch_the_floor_and_a_quarter_floats():
    gaps = []
    for scene in scenes("quickstart", 60):
        normal, offset = next(planes(scene))
        gaps += [(v @ normal).min() - offset for v in world_vertices(scene, "object")]
    # The gap is measured vertically where it is set, and along the tilted floor's normal here.
    resting = np.array(gaps) < 0.00101
    assert np.array(gaps)[resting] == pytest.approx(0.001, rel=0.05)
    assert 1 - resting.mean() == pytest.approx(0.25, abs=0.08)


def test_crowds_shrink_until_they_fit():
    grounded = replace(PLACEMENT, floating=0.0)
    transforms = grounded.sample(np.random.default_rng(1), [PEBBLE] * 80, FLOOR)
    scales = np.array([t.scale[0] for t in transforms])
    assert scales.min() > 0.01
    assert scales.mean() < 2 * (3 * 0.2 / (4 * np.pi * 80)) ** (1 / 3)


def test_where_there_is_no_room_one_line_says_so():
    above_the_cube = OpenRegion(np.array([[0.0, 0.0, 1.0]]), np.array([0.6]))
    with pytest.raises(SceneError, match="found no room"):
        PLACEMENT.sample(np.random.default_rng(0), [PEBBLE], above_the_cube)


def test_upright_objects_are_turned_about_the_vertical_alone():
    values = {field.name: getattr(PLACEMENT, field.name) for field in fields(PLACEMENT)}
    shares = []
    for upright in (0.0, 0.5, 1.0):
        drawn = UprightPlacement(**values, upright=upright).sample(np.random.default_rng(0), [PEBBLE] * 40, FLOOR)
        shares.append(np.mean([t.rotation[:2] == (0, 0) for t in drawn]))
        assert len({t.rotation[2] for t in drawn}) == 40
    assert shares[0] == 0 and 0.25 < shares[1] < 0.75 and shares[2] == 1
