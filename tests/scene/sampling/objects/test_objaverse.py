import sys
import types
import urllib.error

import numpy as np
import pytest
import trimesh
from mesh_folders import prepared

from rfpp.errors import SceneError, UserError
from rfpp.scene.sampling.objects.objaverse import ObjaverseObjects
from rfpp.scene.sampling.objects.object_source import ObjectSource
from rfpp.scene.sampling.objects.preparation import Preparation

UIDS = [f"{i:032x}" for i in range(1, 6)]
LISTED = "\n".join(UIDS)


class Objaverse(types.ModuleType):
    """Fake package: all uids but the last are known, and the one before it was removed."""

    def __init__(self, cache):
        super().__init__("objaverse")
        self.cache = cache
        self.calls = []
        self.connected = True

    def load_objects(self, uids, download_processes=1):
        print("Downloaded 1 / 1 objects")
        self.calls.append(list(uids))
        if not self.connected:
            raise urllib.error.URLError("Name or service not known")
        paths = {}
        for uid in uids:
            if uid == UIDS[3]:
                raise urllib.error.HTTPError("https://hub", 404, "Not Found", None, None)
            if uid in UIDS[:4]:
                paths[uid] = str(self.cache / f"{uid}.glb")
                trimesh.creation.box((1, 2, 2 + int(uid, 16))).export(paths[uid])
        return paths


@pytest.fixture
def hub(tmp_path, monkeypatch):
    module = Objaverse(tmp_path)
    monkeypatch.setitem(sys.modules, "objaverse", module)
    return module


def source(tmp_path, text=LISTED, name="chairs.txt"):
    (tmp_path / name).write_text(text)
    preparation = Preparation(max_faces=100, min_faces=4, non_watertight="reject", most_parts=1, up="z")
    return ObjaverseObjects(str(tmp_path / "objects"), 0.3, preparation, str(tmp_path / name))


def test_unavailable_uids_are_counted(tmp_path, hub, capsys):
    objects = source(tmp_path)
    assert isinstance(objects, ObjectSource)
    library = prepared(objects)
    assert objects.library_root.name == "objaverse-chairs"
    assert [item.id for item in library.index.objects] == UIDS[:3]
    assert [(item.id, item.reason) for item in library.index.rejected] == [(uid, "not available") for uid in UIDS[3:]]
    assert library.index.counts["not available"] == 2
    assert hub.calls[0] == UIDS  # together, then one by one after a failure
    assert capsys.readouterr().out == ""
    assert len(objects.sample(np.random.default_rng(0), 60, held_out=True)[0]) == 60


def test_a_longer_list_downloads_only_new_uids(tmp_path, hub):
    prepared(source(tmp_path, "\n".join(UIDS[:2])))
    hub.calls.clear()
    objects = source(tmp_path, "\n".join(UIDS[:3]) + f"\n{UIDS[0]}  # twice\n\n# the end")
    assert not objects.is_prepared()
    library = prepared(objects)
    assert hub.calls == [UIDS[2:3]]
    assert len(library.index.objects) == 3
    hub.calls.clear()
    assert objects.is_prepared()
    prepared(objects)
    assert hub.calls == []


def test_a_network_failure_is_one_line_and_loses_nothing(tmp_path, hub):
    prepared(source(tmp_path, "\n".join(UIDS[:2])))
    hub.connected = False
    objects = source(tmp_path)
    with pytest.raises(UserError, match=r"cannot be downloaded \(Name or service not known\): connect and run"):
        prepared(objects)
    hub.connected = True
    hub.calls.clear()
    prepared(objects)
    assert hub.calls[0] == UIDS[2:]


@pytest.mark.parametrize(
    ("text", "name", "message"),
    [
        ("chair", "uids.txt", "'chair' is not an Objaverse uid"),
        ("# nothing", "uids.txt", "names no uid"),
        ("[1]", "uids.json", "'1' is not an Objaverse uid"),
        ("{}", "uids.json", "'{}' is not an Objaverse uid"),
    ],
)
def test_bad_lists_are_named(tmp_path, hub, text, name, message):
    with pytest.raises(SceneError, match=f"{name}: .*{message}"):
        source(tmp_path, text, name).originals()


def test_a_missing_list_is_named(tmp_path):
    objects = source(tmp_path)
    (tmp_path / "chairs.txt").unlink()
    with pytest.raises(SceneError, match=r"chairs\.txt: cannot be read \(No such file"):
        objects.originals()
    with pytest.raises(SceneError, match=r"uids is not given: add family\.objects\.uids"):
        ObjaverseObjects("", 0.3, objects.preparation, None)
