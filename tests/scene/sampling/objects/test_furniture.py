import json
import os
import zipfile

import numpy as np
import pytest
import trimesh
from mesh_folders import box, prepared, write_obj

from rfpp.errors import SceneError
from rfpp.scene.io.limits import read_member
from rfpp.scene.mesh import joined
from rfpp.scene.sampling.objects.furniture import Catalogue, FurnitureObjects
from rfpp.scene.sampling.objects.library import Library
from rfpp.scene.sampling.objects.object_source import MixedObjects, ObjectSource
from rfpp.scene.sampling.objects.preparation import Preparation
from rfpp.scene.sampling.objects.procedural import ProceduralObjects

CATALOGUE = """# a comment = of no use
id=shop
name=Shop of Pétanque
license=CC-BY 3.0
provider=example.org

id#1=shop#table
name#1=Table
model#1=/shop/table/table.obj
creator#1=Ann
id#2=shop#stool
model#2=/shop/stool/stool.obj
creator#2=Bob
id#10=shop#plan
model#10=/shop/plan.dae
creator#10=Ann
"""


def archive(tmp_path, name="Shop", catalogue=CATALOGUE):
    top = trimesh.creation.box((2, 0.1, 2)).subdivide()
    table = write_obj(tmp_path / "t.obj", ("wood", top), ("steel", box((0.1, 1, 0.1), (0, -0.55, 0))))
    stool = write_obj(tmp_path / "s.obj", ("wood", trimesh.creation.icosphere(2)))
    with zipfile.ZipFile(tmp_path / f"{name}.sh3f", "w") as made:
        made.writestr("PluginFurnitureCatalog.properties", catalogue.encode("latin-1"))
        made.write(table, "shop/table/table.obj")
        made.write(stool, "shop/stool/stool.obj")
    return tmp_path / f"{name}.sh3f"


def source(tmp_path, files=("Shop",)):
    preparation = Preparation(max_faces=300, min_faces=4, non_watertight="keep", most_parts=4, up="y")
    return FurnitureObjects(
        root=str(tmp_path / "objects"), held_out=0.5, preparation=preparation, library_name="furniture",
        folder=str(tmp_path), files=files,
    )  # fmt: skip


def test_the_models_of_a_catalogue_become_objects_in_parts(tmp_path):
    archive(tmp_path)
    objects = source(tmp_path)
    assert isinstance(objects, ObjectSource)
    library = prepared(objects)
    assert {item.id: item.parts for item in library.index.objects} == {"Shop/shop#table": 2, "Shop/shop#stool": 1}
    table = next(item for item in library.index.objects if item.parts == 2)
    top, leg = library.parts(table)
    assert top.vertices[:, 2].mean() > leg.vertices[:, 2].mean()  # z is up
    assert len(library.parts(next(item for item in library.index.objects if item.parts == 1))) == 1


def test_attribution_is_part_of_the_library_and_the_data_set(tmp_path):
    archive(tmp_path)
    objects = source(tmp_path)
    prepared(objects)
    (tmp_path / "Shop.sh3f").unlink()  # the library does not need its archive
    assert objects.is_prepared()
    attribution = objects.account({})["attribution"]["Shop"]
    assert attribution["license"] == "CC-BY 3.0"
    assert attribution["name"] == "Shop of Pétanque"
    assert attribution["creators"] == ["Ann", "Bob"]
    assert objects.account({})["library"] == Library.load(objects.library_root).hash
    json.dumps(objects.account({}))


@pytest.mark.parametrize("target", [40, 101, 900])
def test_drawn_parts_share_the_faces_and_stay_where_they_are(tmp_path, target):
    archive(tmp_path)
    objects = source(tmp_path)
    library = prepared(objects)
    for held_out in (False, True):
        (item,) = library.part(held_out)
        drawn = objects.sample(np.random.default_rng(0), target, held_out)
        assert len(drawn) == item.parts
        assert 0 <= target - sum(map(len, drawn)) <= 3 * len(drawn)
        before, after = (joined(parts).vertices for parts in (library.parts(item), drawn))
        assert np.ptp(after, axis=0) == pytest.approx(np.ptp(before, axis=0), rel=0.25)


def test_bad_archives_are_named(tmp_path):
    with pytest.raises(SceneError, match=r"Shop\.sh3f: there is no such file: unpack Debian's sweethome3d-furniture"):
        source(tmp_path).originals()
    with pytest.raises(SceneError, match="files is empty"):
        source(tmp_path, files=())
    path = archive(tmp_path)
    with pytest.raises(SceneError, match=r"Shop\.sh3f: holds no other\.obj"):
        read_member(path, "other.obj", 100)
    with pytest.raises(SceneError, match=r"holds more than 100 bytes"):
        read_member(path, "shop/table/table.obj", 100)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(SceneError, match=r"Shop\.sh3f: .* cannot be unpacked"):
        Catalogue.read(path)
    with pytest.raises(SceneError, match="names no model"):
        Catalogue.read(archive(tmp_path, "Empty", "id=empty\n"))


def test_a_missing_model_is_rejected_by_name(tmp_path):
    archive(tmp_path, catalogue=CATALOGUE + "id#3=shop#ghost\nmodel#3=/../../ghost.obj\n")
    library = prepared(source(tmp_path))
    (rejected,) = library.index.rejected
    assert (rejected.id, rejected.reason) == ("Shop/shop#ghost", "unreadable")
    assert "holds no ../../ghost.obj" in rejected.detail


def test_sources_are_mixed_by_their_shares(tmp_path):
    archive(tmp_path)
    furniture = source(tmp_path)
    prepared(furniture)
    solids = ProceduralObjects(["primitive"], pool=10, held_out=0.5, stretched=0.0, deformed=0.0)
    mixed = MixedObjects({"furniture": furniture, "solids": solids}, {"furniture": 3.0, "solids": 1.0})
    assert isinstance(mixed, ObjectSource)
    assert mixed.libraries() == (furniture,)
    rng = np.random.default_rng(0)
    # A held-out object is the table in two parts, a training one the stool, or the other way round.
    parted = next(held_out for held_out in (False, True) if len(furniture.sample(rng, 200, held_out)) == 2)
    drawn = [len(mixed.sample(rng, 200, parted)) for _ in range(200)]
    assert 0.65 < np.mean(np.array(drawn) == 2) < 0.85
    configured = {"shares": {}, "sources": {"furniture": {"folder": "/mine"}, "solids": {"pool": 10}}}
    account = mixed.account(configured)
    assert account["sources"]["solids"] == {"pool": 10}
    assert account["sources"]["furniture"] == furniture.account({})
    with pytest.raises(SceneError, match="give each source a share"):
        MixedObjects({"furniture": furniture}, {"solids": 1.0})
    with pytest.raises(SceneError, match="not all of them 0"):
        MixedObjects({"solids": solids}, {"solids": 0.0})


@pytest.mark.parametrize("method", [zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
def test_damaged_streams_are_refused_in_one_line(tmp_path, method):
    with zipfile.ZipFile(tmp_path / "a.zip", "w", method) as made:
        made.writestr("a.obj", bytes(range(256)) * 400)
        place = made.getinfo("a.obj").header_offset + 30 + len("a.obj")
    content = bytearray((tmp_path / "a.zip").read_bytes())
    content[place + 12 : place + 60] = b"\xff" * 48
    (tmp_path / "a.zip").write_bytes(content)
    with pytest.raises(SceneError, match=r"a\.zip: .*(cannot be unpacked|cannot be read)"):
        read_member(tmp_path / "a.zip", "a.obj", 2**20)


def test_a_pipe_is_no_archive(tmp_path):
    os.mkfifo(tmp_path / "a.zip")
    with pytest.raises(SceneError, match="is not a regular file"):
        read_member(tmp_path / "a.zip", "a.obj", 100)
