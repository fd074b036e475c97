import numpy as np
import pytest
import trimesh
from mesh_folders import bowl, box, write_obj

from rfpp.errors import SceneError
from rfpp.scene.io.mesh_files import load_material_groups
from rfpp.scene.mesh import Mesh, joined
from rfpp.scene.sampling.objects.preparation import Preparation, RejectionError, face_shares
from rfpp.scene.sampling.objects.refinement import is_closed
from rfpp.scene.sampling.objects.solid import volume


def preparation(**changes) -> Preparation:
    """Return a preparation of objects in up to four parts."""
    values = {"max_faces": 400, "min_faces": 4, "non_watertight": "keep", "most_parts": 4, "up": "z"}
    return Preparation(**(values | changes))


STRICT = preparation(max_faces=300, most_parts=1, non_watertight="reject")
BALL = trimesh.creation.icosphere(3)
SHEET = trimesh.creation.box().subdivide()
SHEET.apply_scale((1, 1, 1e-4))


def prepared(tmp_path, mesh, preparation=STRICT, name="mesh.ply"):
    mesh.export(tmp_path / name)
    return preparation(tmp_path / name)


@pytest.mark.parametrize("name", ["mesh.ply", "mesh.stl", "mesh.obj", "mesh.glb"])
def test_a_fine_mesh_is_decimated_normalized_and_still_closed(tmp_path, name):
    BALL.apply_translation((3, 0, 0))
    result = prepared(tmp_path, BALL, name=name)
    assert result.faces_before == 1280
    assert len(result.parts[0]) == 300
    assert result.watertight and is_closed(result.parts[0])
    assert np.linalg.norm(result.parts[0].vertices, axis=1) == pytest.approx(0.5, abs=0.03)


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
def test_unsuitable_meshes_are_rejected_with_their_reason(tmp_path, reason):
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


def test_failed_decimation_is_rejected(tmp_path, monkeypatch):
    def gives_up(mesh, target_faces):
        raise SceneError("the mesh cannot be reduced")

    def tears_open(mesh, target_faces):
        return Mesh(mesh.vertices, mesh.faces[:target_faces])

    for decimate, detail in ((gives_up, "the mesh cannot be reduced"), (tears_open, "no longer closed")):
        monkeypatch.setattr("rfpp.scene.sampling.objects.solid.decimated", decimate)
        with pytest.raises(RejectionError, match=detail) as caught:
            prepared(tmp_path, BALL)
        assert caught.value.reason == "cannot be decimated"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"max_faces": 4, "min_faces": 9}, "9…4 faces: use 1 <= min_faces"),
        ({"non_watertight": "repair"}, "non_watertight is 'repair': choose reject or keep"),
        ({"most_parts": 0}, "most_parts is 0"),
        ({"up": "x"}, "up is 'x'"),
    ],
)
def test_invalid_settings_are_refused(change, message):
    with pytest.raises(SceneError, match=message):
        preparation(**change)


@pytest.fixture
def lamp(tmp_path):
    """OBJ file of a broad foot, a shade above it, and a small switch on the foot."""
    ball = trimesh.creation.icosphere(3, 0.5)
    ball.apply_translation((0, 0, 2))
    return write_obj(tmp_path / "lamp.obj", ("foot", box((2, 2, 0.2))), ("shade", ball),
                     ("switch", box((0.1, 0.1, 0.1), (0.9, 0, 0.15))))  # fmt: skip


def test_each_material_is_a_part_and_small_ones_join_the_nearest(lamp):
    assert [len(group) for group in load_material_groups(lamp)] == [12, 1280, 12]
    result = preparation()(lamp)
    foot, shade = result.parts
    assert 12 <= len(foot) <= 24  # the box and its switch
    assert 300 <= len(shade) <= 400 - len(foot)
    assert is_closed(shade)
    assert result.faces_before == 1304
    whole = joined(result.parts)
    assert np.linalg.norm(whole.vertices, axis=1).max() == pytest.approx(0.5, abs=1e-5)
    assert shade.vertices[:, 2].min() > foot.vertices[:, 2].max()


def test_up_is_turned_to_z(lamp):
    upright, lying = preparation()(lamp).parts, preparation(up="y")(lamp).parts
    along_z, along_y = (np.ptp(joined(parts).vertices, axis=0) for parts in (upright, lying))
    assert along_y == pytest.approx(along_z[[0, 2, 1]], abs=1e-4)
    assert (lying[1].vertices[:, 1] < lying[0].vertices[:, 1].min()).all()  # the shade is in front of the foot


def test_a_part_that_cannot_be_decimated_joins_another(tmp_path):
    rng = np.random.default_rng(0)
    corners = rng.uniform(-1, 1, (30, 1, 3)) + rng.uniform(-0.6, 0.6, (30, 3, 3))
    leaves = trimesh.Trimesh(corners.reshape(-1, 3), np.arange(90).reshape(-1, 3), process=False)
    ball = trimesh.creation.icosphere(4, 2.0)
    plant = write_obj(tmp_path / "plant.obj", ("pot", ball), ("leaves", leaves))
    assert len(preparation(max_faces=4000)(plant).parts) == 2
    few = preparation(max_faces=60)(plant).parts
    assert sum(map(len, few)) <= 60


def test_open_parts_are_kept_or_rejected(tmp_path):
    sheet = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    table = write_obj(tmp_path / "table.obj", ("top", sheet), ("leg", box((0.1, 0.1, 1), (0.5, 0.5, -0.5))))
    assert not preparation()(table).watertight
    with pytest.raises(RejectionError, match="not watertight"):
        preparation(non_watertight="reject")(table)


def test_shares_are_even_bounded_and_in_proportion():
    assert face_shares([100, 300], 200) == [56, 144]
    for counts, total in (([1, 1, 1000], 101), ([7, 9], 24), ([5000, 2, 2, 2], 301)):
        shares = face_shares(counts, total)
        assert sum(shares) <= total and min(shares) >= 12 and all(share % 2 == 0 for share in shares)
    with pytest.raises(SceneError, match="47 faces are too few for 4 parts"):
        face_shares([1, 1, 1, 1], 47)
