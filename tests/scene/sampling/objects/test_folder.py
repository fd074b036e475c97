import json
import os
import pickle
import shutil
from collections import Counter

import numpy as np
import pytest
import trimesh
from mesh_folders import GOOD, bowl, fill, one_by_one, prepared, source

from rfpp.errors import SceneError
from rfpp.scene.mesh import joined
from rfpp.scene.sampling.objects.library import Library, mesh_path
from rfpp.scene.sampling.objects.library_building import prepare
from rfpp.scene.sampling.objects.object_source import ObjectSource
from rfpp.scene.sampling.objects.refinement import is_closed


@pytest.fixture
def folder(tmp_path):
    return fill(tmp_path / "meshes")


@pytest.fixture
def objects(folder, tmp_path):
    return source(folder, tmp_path / "objects")


def counting(job, items):
    """A `Map` that records its originals."""
    for item in items:
        counting.seen.append(item.id)
        yield item, job(item)


def run(objects, map=counting):
    counting.seen = []
    return prepare(objects, map, lambda done, total: None)


def files(root):
    return {path.relative_to(root): path.read_bytes() for path in sorted(root.rglob("*")) if path.is_file()}


def test_every_file_becomes_an_object(objects):
    library = run(objects)
    assert isinstance(objects, ObjectSource)
    assert sorted(item.id for item in library.index.objects) == sorted(GOOD)
    assert library.index.rejected == ()
    assert {item.id: item.faces_before for item in library.index.objects}["ball.obj"] == 5120
    for item in library.index.objects:
        assert item.faces == len(joined(library.parts(item))) <= 400
        assert item.watertight and is_closed(joined(library.parts(item)))
    assert library.index.counts == Counter(item.part for item in library.index.objects)


def test_held_out_objects_follow_from_their_ids(tmp_path):
    folder = tmp_path / "many"
    folder.mkdir()
    for i in range(60):
        trimesh.creation.box((1, 2, 3 + i)).export(folder / f"{i:02d}.stl")
    library = prepared(source(folder, tmp_path / "objects", held_out=0.25))
    test = {item.id for item in library.part(True)}
    assert 6 <= len(test) <= 26
    assert test.isdisjoint(item.id for item in library.part(False))
    for i in range(0, 60, 2):
        (folder / f"{i:02d}.stl").unlink()
    smaller = prepared(source(folder, tmp_path / "objects", held_out=0.25))
    assert {item.id for item in smaller.part(True)} == {i for i in test if int(i[:2]) % 2}
    extreme = prepared(source(folder, tmp_path / "objects", held_out=0.001))
    assert len(extreme.part(True)) == 1


def test_only_new_and_changed_files_are_prepared(objects, folder):
    first = run(objects)
    assert sorted(counting.seen) == sorted(GOOD)
    before = files(objects.library_root)
    again = run(objects)
    assert counting.seen == []
    assert again.hash == first.hash
    assert files(objects.library_root) == before
    trimesh.creation.icosphere(2).export(folder / "ball.obj")
    (folder / "cone.OBJ").unlink()
    trimesh.creation.annulus(1, 2, 1).export(folder / "washer.ply")
    changed = run(objects)
    assert sorted(counting.seen) == ["ball.obj", "washer.ply"]
    assert changed.hash != first.hash
    assert "cone.OBJ" not in changed.ids


def test_an_interrupted_build_resumes_to_the_same_library(objects, tmp_path, folder):
    whole = run(source(folder, tmp_path / "whole"))
    for stop in range(len(GOOD)):

        def dying(job, items, stop=stop):
            for i, item in enumerate(items):
                if i == stop:
                    raise KeyboardInterrupt
                yield item, job(item)

        with pytest.raises(KeyboardInterrupt):
            run(objects, dying)
        assert not objects.is_prepared()
        finished = run(objects)
        assert len(counting.seen) == len(GOOD) - stop
        assert finished.hash == whole.hash
        assert files(objects.library_root).keys() == files(tmp_path / "whole" / "meshes").keys()
        shutil.rmtree(objects.library_root)


def test_damaged_records_and_meshes_are_rebuilt(objects):
    hash_before = run(objects).hash
    records = sorted((objects.library_root / "records").rglob("*.json"))
    records[0].write_text("{")
    records[1].write_bytes(b"\xff")
    mesh_path(objects.library_root, "box.gltf").unlink()
    assert run(objects).hash == hash_before
    assert 2 <= len(counting.seen) <= 3
    path = mesh_path(objects.library_root, "ball.obj")
    path.write_bytes(path.read_bytes()[:-1])
    run(objects)
    assert counting.seen == ["ball.obj"]


def test_rejections_are_listed_and_counted_by_reason(objects, folder):
    shutil.copy(folder / "ball.obj", folder / "the same ball.obj")
    (folder / "broken.ply").write_text("ply")
    bowl().export(folder / "bowl.stl")

    def with_a_crash(job, items):
        for item, result in one_by_one(job, items):
            yield item, RuntimeError("out of memory\nand more") if item.id == "box.gltf" else result

    library = run(objects, with_a_crash)
    rejected = {item.id: item for item in library.index.rejected}
    reasons = {i: item.reason for i, item in rejected.items()}
    assert reasons == {
        "the same ball.obj": "duplicate",
        "broken.ply": "unreadable",
        "bowl.stl": "not watertight",
        "box.gltf": "crashed",
    }
    assert rejected["the same ball.obj"].detail == "the same mesh as ball.obj"
    assert rejected["box.gltf"].detail == "RuntimeError: out of memory"
    assert {k: v for k, v in library.index.counts.items() if k in reasons.values()} == dict.fromkeys(
        reasons.values(), 1
    )
    written = json.loads((objects.library_root / "library.json").read_text())
    assert {entry["id"] for entry in written["rejected"]} == set(rejected)
    kept = run(source(folder, objects.root, non_watertight="keep"))
    assert {"bowl.stl": False}.items() <= {item.id: item.watertight for item in kept.index.objects}.items()


def test_objects_are_drawn_from_their_part_with_the_requested_faces(objects):
    library = run(objects)
    shapes = {}
    for held_out in (False, True):
        rng = np.random.default_rng(0)
        for target in (50, 151, 300, 1200) * 4:
            (mesh,) = objects.sample(rng, target, held_out)
            assert len(mesh) == target // 2 * 2
            assert is_closed(mesh)
            assert np.linalg.norm(mesh.vertices, axis=1).max() == pytest.approx(0.5, abs=1e-5)
        rng = np.random.default_rng(1)
        drawn = Counter(objects.sample(rng, 1200, held_out)[0].vertices.tobytes() for _ in range(60))
        assert len(drawn) == len(library.part(held_out))
        shapes[held_out] = set(drawn)
    assert shapes[False].isdisjoint(shapes[True])


def test_a_library_works_without_its_folder_and_in_other_processes(objects, folder):
    run(objects)
    content, (mesh,) = objects.account({}), objects.sample(np.random.default_rng(0), 100, False)
    shutil.rmtree(folder)
    assert objects.is_prepared()
    copy = pickle.loads(pickle.dumps(objects))
    assert len(pickle.dumps(objects)) < 2000  # no library inside
    assert copy.account({}) == content == {"library": Library.load(objects.library_root).hash}
    assert np.array_equal(copy.sample(np.random.default_rng(0), 100, False)[0].vertices, mesh.vertices)


def test_unprepared_sources_say_how_to_prepare_them(objects, folder):
    for ask in (lambda: objects.account({}), lambda: objects.sample(np.random.default_rng(0), 100, False)):
        with pytest.raises(SceneError, match=r"not prepared: make it with .*action=prepare"):
            ask()
    assert not objects.is_prepared()
    run(objects)
    assert objects.is_prepared()
    other = source(folder, objects.root, held_out=0.3)
    assert not other.is_prepared()
    with pytest.raises(SceneError, match=r"other settings: make it with .*action=prepare"):
        other.account({})
    trimesh.creation.box().export(folder / "new.stl")
    assert not objects.is_prepared()


def test_damage_is_reported_by_name(objects):
    library = run(objects)
    path = mesh_path(library.root, "ball.obj")
    path.write_bytes(path.read_bytes()[:-1])
    ball = next(item for item in library.index.objects if item.id == "ball.obj")
    with pytest.raises(SceneError, match=f"{path.name}: is damaged"):
        library.parts(ball)
    path.unlink()
    with pytest.raises(SceneError, match=f"{path.name}: cannot be read"):
        library.parts(ball)
    (library.root / "library.json").write_text("{}")
    os.utime(library.root / "library.json", (1, 1))
    with pytest.raises(SceneError, match=r"library\.json: is damaged"):
        objects.account({})


def test_too_few_objects_are_refused_with_the_reasons(tmp_path):
    folder = tmp_path / "few"
    folder.mkdir()
    trimesh.creation.box().export(folder / "one.stl")
    (folder / "two.ply").write_text("")
    with pytest.raises(SceneError, match=r"1 of 2 meshes became objects \(rejected: 1 unreadable\), and two are"):
        prepared(source(folder, tmp_path))


@pytest.mark.parametrize(("name", "message"), [("nowhere", "no such folder"), ("empty", "holds no mesh")])
def test_folders_without_meshes_are_named(tmp_path, name, message):
    (tmp_path / "empty").mkdir()
    with pytest.raises(SceneError, match=f"{name}: .*{message}"):
        prepared(source(tmp_path / name, tmp_path))
    with pytest.raises(SceneError, match=r"folder is not given: add family\.objects\.folder"):
        source("", tmp_path)
    with pytest.raises(SceneError, match="held_out is 1.0"):
        source(tmp_path, tmp_path, held_out=1.0)
