import numpy as np
import pytest
import trimesh
from mesh_folders import bowl

from rfpp.errors import SceneError
from rfpp.scene.mesh import Mesh
from rfpp.scene.sampling.objects.preparation import Preparation, RejectionError
from rfpp.scene.sampling.objects.refinement import is_closed
from rfpp.scene.sampling.objects.solid import volume

STRICT = Preparation(max_faces=300, min_faces=4, non_watertight="reject")
TOLERANT = Preparation(max_faces=300, min_faces=4, non_watertight="keep")

BALL = trimesh.creation.icosphere(3)
SHEET = trimesh.creation.box().subdivide()
SHEET.apply_scale((1, 1, 1e-4))


def prepared(tmp_path, mesh, preparation=STRICT, name="mesh.ply"):
    mesh.export(tmp_path / name)
    return preparation(tmp_path / name)


@pytest.mark.parametrize("name", ["mesh.ply", "mesh.stl", "mesh.obj", "mesh.glb"])
def test_a_good_mesh_is_normalised_at_the_tier_and_still_closed(tmp_path, name):
    BALL.apply_translation((3, 0, 0))
    result = prepared(tmp_path, BALL, name=name)
    assert result.faces_before == 1280
    assert len(result.parts[0]) == 300
    assert result.watertight and is_closed(result.parts[0])
    assert np.linalg.norm(result.parts[0].vertices, axis=1) == pytest.approx(0.5, abs=0.03)


def test_a_mesh_below_the_tier_keeps_its_faces(tmp_path):
    assert len(prepared(tmp_path, trimesh.creation.box()).parts[0]) == 12


@pytest.mark.parametrize("flipped", [slice(None), slice(0, 40)], ids=["inside out", "partly"])
def test_faces_are_turned_outwards(tmp_path, flipped):
    faces = BALL.faces.copy()
    faces[flipped] = faces[flipped][:, ::-1]
    result = prepared(tmp_path, trimesh.Trimesh(BALL.vertices, faces, process=False))
    assert volume(result.parts[0]) == pytest.approx(np.pi / 6, rel=0.15)


def test_repeated_and_degenerate_faces_are_cleaned_away(tmp_path):
    dirty = np.concatenate([BALL.faces, BALL.faces[:5], [[0, 0, 1], [3, 3, 3]]])
    result = prepared(tmp_path, trimesh.Trimesh(BALL.vertices, dirty, process=False))
    assert result.faces_before == 1287
    assert result.watertight and len(result.parts[0]) == 300


REJECTED = {
    "flat": SHEET,
    "too few faces": trimesh.Trimesh(np.eye(3), [[0, 1, 2]]),
    "degenerate": trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [2, 0, 0]] * 2, [[0, 1, 2], [3, 4, 5]], process=False),
    "not watertight": bowl(),
}


@pytest.mark.parametrize("reason", REJECTED)
def test_what_is_no_object_is_rejected_with_its_reason(tmp_path, reason):
    with pytest.raises(RejectionError) as caught:
        prepared(tmp_path, REJECTED[reason])
    assert caught.value.reason == reason
    assert caught.value.detail


@pytest.mark.parametrize("content", [b"", b"ply\nrubbish", b"v 0 0 0\nf 1 2 3\n"])
def test_unreadable_files_are_rejected_without_their_path_in_the_detail(tmp_path, content):
    for suffix in ("obj", "ply", "stl", "glb", "gltf"):
        path = tmp_path / f"bad.{suffix}"
        path.write_bytes(content)
        with pytest.raises(RejectionError) as caught:
            STRICT(path)
        assert caught.value.reason == "unreadable"
        assert str(tmp_path) not in caught.value.detail
        assert "\n" not in caught.value.detail


def test_what_decimation_tears_open_or_gives_up_is_rejected(tmp_path, monkeypatch):
    def gives_up(mesh, target_faces):
        raise SceneError("the mesh cannot be reduced")

    def tears_open(mesh, target_faces):
        return Mesh(mesh.vertices, mesh.faces[:target_faces])

    for decimate, detail in ((gives_up, "the mesh cannot be reduced"), (tears_open, "not closed any more")):
        monkeypatch.setattr("rfpp.scene.sampling.objects.solid.decimated", decimate)
        with pytest.raises(RejectionError, match=detail) as caught:
            prepared(tmp_path, BALL)
        assert caught.value.reason == "cannot be decimated"


def test_open_meshes_can_be_kept(tmp_path):
    result = prepared(tmp_path, bowl(), TOLERANT)
    assert not result.watertight
    assert 0 < len(result.parts[0]) <= 300
    assert np.linalg.norm(result.parts[0].vertices, axis=1).max() == pytest.approx(0.5, abs=1e-5)


def test_wrong_settings_are_refused():
    with pytest.raises(SceneError, match="9…4 faces are no range"):
        Preparation(max_faces=4, min_faces=9, non_watertight="reject")
    with pytest.raises(SceneError, match="non_watertight is 'repair': choose reject or keep"):
        Preparation(max_faces=4, min_faces=1, non_watertight="repair")
