import numpy as np
import pytest
import trimesh
from mesh_folders import box, write_obj

from rfpp.errors import SceneError
from rfpp.scene.io.mesh_files import load_material_groups
from rfpp.scene.mesh import joined, normalized, normalized_together
from rfpp.scene.sampling.objects.material_groups import MaterialGroups, face_shares
from rfpp.scene.sampling.objects.preparation import RejectionError
from rfpp.scene.sampling.objects.refinement import is_closed


def preparation(**changes):
    values = {"max_faces": 400, "min_faces": 4, "non_watertight": "keep", "most_parts": 4, "up": "z"}
    return MaterialGroups(**(values | changes))


@pytest.fixture
def lamp(tmp_path):
    """A broad foot, a shade above it, and a switch on the foot that is too small to be a part."""
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
    assert (lying[1].vertices[:, 1] < lying[0].vertices[:, 1].min()).all()  # what was above lies in front of it


def test_most_parts_bounds_them(lamp):
    (whole,) = preparation(most_parts=1)(lamp).parts
    assert len(whole) <= 400
    with pytest.raises(SceneError, match="most_parts is 0"):
        preparation(most_parts=0)
    with pytest.raises(SceneError, match="up is 'x'"):
        preparation(up="x")


def test_a_part_that_cannot_be_reduced_to_its_share_joins_another(tmp_path):
    """Of loose triangles nothing can be collapsed: they get along with the box in one part, or in none."""
    rng = np.random.default_rng(0)
    corners = rng.uniform(-1, 1, (30, 1, 3)) + rng.uniform(-0.6, 0.6, (30, 3, 3))
    leaves = trimesh.Trimesh(corners.reshape(-1, 3), np.arange(90).reshape(-1, 3), process=False)
    ball = trimesh.creation.icosphere(4, 2.0)
    plant = write_obj(tmp_path / "plant.obj", ("pot", ball), ("leaves", leaves))
    assert len(preparation(max_faces=4000)(plant).parts) == 2
    few = preparation(max_faces=60)(plant).parts
    assert sum(map(len, few)) <= 60
    with pytest.raises(RejectionError, match="cannot be decimated"):
        preparation(max_faces=4)(plant)


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


def test_parts_are_normalised_as_their_whole_is(lamp):
    groups = load_material_groups(lamp)
    together, whole = joined(normalized_together(groups)), normalized(joined(groups))
    assert np.allclose(together.corners, whole.corners, atol=1e-6)
