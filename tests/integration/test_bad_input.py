import json
import os
import resource
import shutil
import subprocess
import sys

import pytest
import torch
from marks import requires_blender
from mlflow.exceptions import MlflowException
from networks import checkpoint_info, network
from small_data import make

from rfpp.checkpoint.loading import CHECKPOINT_KEY, NETWORK_PREFIX
from rfpp.commands import CONFIG_DIR

REPOSITORY = CONFIG_DIR.parent
CORNELL_BOX = REPOSITORY / "data" / "scenes" / "cornell_box.json"


ONE_SCENE = "data.splits={train: 1, train_newviews: 0, validation: 0, test: 0}"


def command(verb: str, *overrides: str, **how) -> subprocess.CompletedProcess:
    line = [sys.executable, f"launch/{verb}.py", *overrides]
    return subprocess.run(line, cwd=REPOSITORY, capture_output=True, text=True, check=False, timeout=300, **how)


def only_line(done: subprocess.CompletedProcess, status: int = 1) -> str:
    """The one line on stderr of a command that was refused."""
    assert done.returncode == status
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1
    return done.stderr


@pytest.fixture
def refused(capsys):
    """`refused(task, cfg)`: the one line that a verb answers with, and nothing else on stderr."""

    def run(task, cfg) -> str:
        capsys.readouterr()
        with pytest.raises(SystemExit) as stop:
            task.__wrapped__(cfg)
        assert stop.value.code == 1
        lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]
        assert len(lines) == 1
        return lines[0]

    return run


@pytest.fixture
def box(tmp_path):
    """The Cornell box as a dictionary to damage, and a folder with its meshes to damage too."""
    shutil.copytree(CORNELL_BOX.parent / "meshes", tmp_path / "meshes")
    return json.loads(CORNELL_BOX.read_text())


def damage_mesh(folder, box, content):
    path = folder / "meshes" / "bad.obj"
    if content is not None:
        path.write_text(content)
    box["objects"]["floor"]["mesh_path"] = "meshes/bad.obj"


TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
SCENE_DAMAGE = {
    "missing mesh": (lambda d, box: damage_mesh(d, box, None), "bad.obj"),
    "face index out of range": (lambda d, box: damage_mesh(d, box, TRIANGLE + "f 1 2 9\n"), "bad.obj"),
    "NaN vertex": (lambda d, box: damage_mesh(d, box, TRIANGLE.replace("v 1 0", "v nan 0") + "f 1 2 3\n"), "bad.obj"),
    "reflectance above 1": (lambda d, box: box["objects"]["floor"]["material"].update(diffuse=[1.2, 0, 0]), "diffuse"),
    "negative reflectance": (lambda d, box: box["objects"]["floor"]["material"].update(specular=[-1] * 3), "specular"),
    "unknown key": (lambda d, box: box["objects"]["floor"]["material"].update(metalness=1), "metalness"),
    "other version": (lambda d, box: box.update(version="2.0"), "version"),
    "empty scene": (lambda d, box: box.update(objects={}), "objects"),
    "camera inside out": (lambda d, box: box["cameras"][0].update(look_at=box["cameras"][0]["position"]), "look_at"),
}  # fmt: skip


@pytest.mark.parametrize(("damage", "named"), SCENE_DAMAGE.values(), ids=SCENE_DAMAGE.keys())
def test_a_bad_scene(damage, named, box, tmp_path, composed, refused):
    from launch.render import main

    damage(tmp_path, box)
    path = tmp_path / "scene.json"
    path.write_text(json.dumps(box))
    line = refused(main, composed("render", f"scene={path}", "checkpoint=none.ckpt"))
    assert named in line
    assert str(path) in line or "bad.obj" in line


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    splits = {"train": 2, "train_newviews": 1, "validation": 1, "test": 1}
    return make(tmp_path_factory.mktemp("data") / "small", splits=splits).root


@pytest.fixture
def checkpoint(composed, tmp_path):
    """A checkpoint whose weights are not those of the model that it names."""
    from omegaconf import OmegaConf

    model = OmegaConf.to_container(composed("train", "run_dir=unused").model, resolve=True)
    state = {NETWORK_PREFIX + k: v for k, v in network().state_dict().items()}
    info = checkpoint_info(model, (64, 64)).to_dict()
    torch.save({CHECKPOINT_KEY: info, "state_dict": state}, tmp_path / "other.ckpt")
    return tmp_path / "other.ckpt"


def test_a_checkpoint_of_another_model(checkpoint, composed, refused):
    from launch.render import main

    line = refused(main, composed("render", f"scene={CORNELL_BOX}", f"checkpoint={checkpoint}"))
    assert "other.ckpt" in line
    assert "another model" in line


def test_missing_data_names_the_command_that_makes_it(tmp_path, composed, refused):
    from launch.train import main

    line = refused(main, composed("train", "debug=cpu", f"data.root={tmp_path}/none", "loss.lpips_weight=0.0"))
    assert f"{tmp_path}/none" in line
    assert "launch/generate.py" in line


def test_an_experiment_that_does_not_exist_is_refused_with_those_that_do():
    line = only_line(command("train", "experiment=quickstrat"), status=2)
    assert "experiment/quickstrat" in line
    assert "large_scale" in line


@pytest.mark.filterwarnings("ignore:MLflow at")
def test_a_full_tracking_database_does_not_stop_training(data, composed, monkeypatch, tmp_path, capsys):
    from launch.train import main

    def full(*_, **__):
        raise MlflowException("(sqlite3.OperationalError) database or disk is full [SQL: INSERT INTO metrics …]")

    monkeypatch.setattr("mlflow.MlflowClient.log_batch", full)
    cfg = composed(
        "train", "debug=cpu", f"data.root={data}", "data.resolution=8", "loss.lpips_weight=0.0", "steps=2",
        "trainer.val_check_interval=2", f"run_dir={tmp_path}/run", f"logger.folder={tmp_path}", "logger.patience=2.0",
    )  # fmt: skip
    assert main.__wrapped__(cfg).is_file()
    assert "send it with" in capsys.readouterr().out


def test_no_blender_installed(tmp_path):
    (tmp_path / "bpy").mkdir()
    (tmp_path / "bpy" / "__init__.py").write_text("raise ModuleNotFoundError(\"No module named 'bpy'\", name='bpy')")
    small = ["reference=preview", "data.resolution=16", "farm.workers=1", ONE_SCENE, f"data.root={tmp_path}/data"]
    done = command("generate", "experiment=quickstart", *small, env={**os.environ, "PYTHONPATH": str(tmp_path)})
    assert done.returncode == 1
    assert [line for line in done.stderr.splitlines() if line.startswith("error: ")] == [done.stderr.strip()]
    assert "pip install" in done.stderr


@requires_blender
@pytest.mark.parametrize("verb", ["generate", "train"])
def test_a_full_disk_while_writing(verb, data, tmp_path):
    """A limit on file sizes stands in for the disk: no root needed, the same kind of error."""
    overrides = {
        "generate": ["experiment=quickstart", "reference=preview", "data.resolution=32", "reference.samples=1",
                     "farm.workers=1", ONE_SCENE, f"data.root={tmp_path}/data"],
        "train": ["debug=cpu", f"data.root={data}", "data.resolution=8", "steps=1", "trainer.val_check_interval=1",
                  "loss.lpips_weight=0.0", f"run_dir={tmp_path}/run", f"logger.folder={tmp_path}"],
    }  # fmt: skip
    limit = {"generate": 50_000, "train": 5_000_000}[verb]
    done = command(verb, *overrides[verb], preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)))
    assert done.returncode == 1, done.stderr
    assert "Traceback" not in done.stderr
    assert "free" in next(line for line in done.stderr.splitlines() if line.startswith("error: "))
    assert not list(tmp_path.rglob("*.ckpt"))
