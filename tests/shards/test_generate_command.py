"""launch/generate.py as a user runs it."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
import trimesh
from marks import requires_blender
from PIL import Image

from rfpp.shards.manifest import Manifest

REPOSITORY = Path(__file__).resolve().parents[2]


#: Generates one small scene.
COMMAND = (
    sys.executable, "launch/generate.py", "experiment=quickstart", "reference=preview", "data.resolution=16",
    "reference.samples=1",
    "farm.workers=1", "data.splits={train: 1, train_newviews: 0, validation: 0, test: 0}",
)  # fmt: skip


def run(*overrides: str) -> subprocess.CompletedProcess:
    return subprocess.run([*COMMAND, *overrides], cwd=REPOSITORY, capture_output=True, text=True, check=False)


@requires_blender
def test_generate_then_nothing_to_do_then_refused(tmp_path):
    root = f"data.root={tmp_path}"
    made = run(root)
    assert made.returncode == 0, made.stderr
    assert "Generated 1 scenes" in made.stdout
    assert "images/s" in made.stdout
    assert Manifest.load(tmp_path).counts["images"] == 4
    shown = run(root, "action=show", "sample=train-000000", f"output={tmp_path}/pictures")
    assert shown.returncode == 0, shown.stderr
    assert Image.open(tmp_path / "pictures/train-000000.png").size[0] > 500
    assert "no sample 'train-000001'" in run(root, "action=show", "sample=train-000001").stderr
    assert "Nothing to do: all 1 scenes" in run(root).stdout
    refused = run(root, "reference.samples=2")
    assert refused.returncode == 1
    assert refused.stderr.count("\n") == 1
    assert "reference.samples (1 there, 2 now)" in refused.stderr


def workers(command: psutil.Process) -> list[psutil.Process]:
    """Return worker processes, including those that are still importing."""
    found = []
    for child in command.children():
        with contextlib.suppress(psutil.NoSuchProcess):  # git, which has exited meanwhile
            found += [child] * ("spawn_main" in " ".join(child.cmdline()))
    return found


@requires_blender
@pytest.mark.parametrize("moment", ["workers", "scenes"])
def test_control_c_ends_all_processes_with_one_line_and_the_command_resumes(tmp_path, moment):
    overrides = ("data.splits={train: 3, train_newviews: 0, validation: 0, test: 0}", f"data.root={tmp_path}/data")
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True, "start_new_session": True}
    process = subprocess.Popen([*COMMAND, *overrides], cwd=REPOSITORY, **pipes)
    command = psutil.Process(process.pid)
    while not (workers(command) if moment == "workers" else [*tmp_path.rglob("*.sample")]):
        assert process.poll() is None, process.stderr.read()
        time.sleep(0.01)
    children = command.children(recursive=True)
    os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate(timeout=120)
    assert said == "interrupted: run the same command again to resume; finished scenes are kept\n"
    assert process.returncode == -signal.SIGINT  # exit status 130 in a shell
    assert psutil.wait_procs(children, timeout=60)[1] == []
    if moment == "scenes":
        kept = [*tmp_path.rglob("*.sample")]
        again = run(*overrides)
        assert again.returncode == 0, again.stderr
        assert f"Generated {3 - len(kept)} scenes" in again.stdout


@requires_blender
def test_a_folder_of_meshes_is_prepared_and_rendered(tmp_path):
    (tmp_path / "meshes").mkdir()
    trimesh.creation.icosphere(2).export(tmp_path / "meshes/ball.ply")
    trimesh.creation.torus(1, 0.3).export(tmp_path / "meshes/ring.glb")
    (tmp_path / "meshes/broken.obj").write_text("f 1 2 3")
    folders = [f"family.objects.folder={tmp_path}/meshes", f"family.objects.root={tmp_path}/objects"]
    made = run("family/objects=folder", *folders, f"data.root={tmp_path}/data")
    assert made.returncode == 0, made.stderr
    assert "broken.obj: unreadable" in made.stdout
    assert "1 held_out" in made.stdout
    assert Manifest.load(tmp_path / "data").counts["scenes"] == 1


def test_procedural_objects_need_no_preparation():
    refused = run("action=prepare")
    assert refused.returncode == 1
    assert "need no preparation" in refused.stderr


def test_a_preview_needs_no_blender(tmp_path):
    assert run("preview=2", f"output={tmp_path}").returncode == 0
    assert Image.open(tmp_path / "quickstart_preview.png").size[0] > 400
