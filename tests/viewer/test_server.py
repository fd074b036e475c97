"""The viewer's server, without a browser."""

import tempfile
from pathlib import Path

import pytest
from edited_scenes import scene

from rfpp.errors import UserError
from rfpp.files import is_plain_name
from rfpp.viewer.controls import scene_file
from rfpp.viewer.server import Viewer


@pytest.mark.parametrize(
    ("host", "port", "named"), [("127.0.0.1", 70000, "port=70000"), ("203.0.113.7", 0, "host=203")]
)
def test_an_address_that_is_not_ours_is_refused(renderer, tracer, host, port, named):
    with pytest.raises(UserError, match=named):
        Viewer(renderer, scene(), {}, tracer, host, port, longer_side=64, moving_seconds=1)


@pytest.mark.parametrize("name", ["../../escaped", "/tmp/escaped", "a/b", "..", "\\..\\x"])
def test_a_scene_is_saved_under_a_plain_name(name, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    file, content = scene_file(scene().model_copy(update={"name": name}), scene().cameras[0])
    assert is_plain_name(file) and len(content) > 100
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]  # nothing is left, nothing went elsewhere
    assert not (tmp_path.parent / "escaped.json").exists() and not Path("/tmp/escaped.json").exists()
