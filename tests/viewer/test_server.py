"""The viewer's server without a browser: addresses, files and references."""

import tempfile
import zipfile
from io import BytesIO
from pathlib import Path

import pytest
import trimesh
from edited_scenes import scene
from hydra import compose, initialize_config_dir
from marks import requires_blender
from omegaconf import OmegaConf

from rfpp.commands import CONFIG_DIR
from rfpp.errors import UserError
from rfpp.files import is_plain_name
from rfpp.inference.scene_settings import LoadSettings
from rfpp.scene.io.loading import load_scene
from rfpp.viewer.controls import scene_file
from rfpp.viewer.server import Viewer
from rfpp.viewer.session import path_trace


@pytest.mark.parametrize(
    ("host", "port", "named"), [("127.0.0.1", 70000, "port=70000"), ("203.0.113.7", 0, "host=203")]
)
def test_an_address_of_another_machine_is_refused(renderer, cycles, host, port, named):
    with pytest.raises(UserError, match=named):
        Viewer(renderer, scene(), {}, cycles, host, port, longer_side=64, moving_seconds=1)


@pytest.mark.parametrize("name", ["../../escaped", "/tmp/escaped", "a/b", "..", "\\..\\x"])
def test_a_scene_is_saved_under_a_plain_name(name, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    file, content = scene_file(scene().model_copy(update={"name": name}), scene().cameras[0])
    assert is_plain_name(file) and len(content) > 100
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]  # no files remain, here or elsewhere
    assert not (tmp_path.parent / "escaped.json").exists() and not Path("/tmp/escaped.json").exists()


def test_a_saved_scene_loads_again(tmp_path):
    name, content = scene_file(scene(), scene().cameras[1])
    with zipfile.ZipFile(BytesIO(content)) as archive:
        archive.extractall(tmp_path)
    loaded = load_scene(tmp_path / name.replace(".zip", ".json"))
    assert [item.name for item in loaded.objects] == [item.name for item in scene().objects]
    assert loaded.cameras == (scene().cameras[1],)


@requires_blender
def test_a_reference_shows_its_view(cycles):
    reference = path_trace(scene(), scene().cameras[0], (16, 24), cycles)
    assert reference.radiance.shape == (16, 24, 3) and reference.radiance.max() > 0
    assert reference.shows(reference.scene, scene().cameras[0], (16, 24))
    assert not reference.shows(reference.scene, scene().cameras[1], (16, 24))


def test_a_file_is_read_as_the_command_says(tmp_path):
    trimesh.creation.icosphere(3).export(tmp_path / "ball.stl")
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        cfg = compose("view", overrides=["triangles=300", "backdrop=none", "up=y"])
    loading = LoadSettings.parse(OmegaConf.to_container(cfg, resolve=True))
    with pytest.warns(UserWarning, match="triangles were reduced to"):
        ball = loading.load(tmp_path / "ball.stl")
    assert [item.name for item in ball.objects] == ["ball", "key_light", "fill_light", "back_light"]
    assert len(ball.objects[0].mesh) <= 300
