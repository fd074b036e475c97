"""The wheel carries all that it needs: it is installed beside the libraries and used where no source tree is."""

import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
#: What the package carries of the source tree, and where.
CARRIED = {"rfpp": "rfpp", "conf": "rfpp/_conf", "launch": "rfpp/_launch", "data/models": "rfpp/_models"}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Built from a copy, since building leaves files in the source tree."""
    folder = tmp_path_factory.mktemp("wheel")
    for name in CARRIED:
        shutil.copytree(ROOT / name, folder / "source" / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, folder / "source")
    pip("wheel", "--no-build-isolation", "--wheel-dir", str(folder), str(folder / "source"))
    [path] = folder.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """`installed(*arguments)`: what the command `rfpp` prints in an empty folder, `installed.folder`.

    The package is in `installed.site`.
    """
    project = tmp_path_factory.mktemp("project")  # another one's, as an environment often lies in one
    site, empty = project / "site", project / "empty"
    empty.mkdir()
    for verb in (["init"], ["-c", "user.name=a", "-c", "user.email=a@b", "commit", "--allow-empty", "-m", "theirs"]):
        subprocess.run(["git", "-C", str(project), *verb, "--quiet"], check=True)
    pip("install", "--target", str(site), str(wheel))

    def run(*arguments: str, code: int = 0) -> str:
        environment = os.environ | {"PYTHONPATH": str(site), "OMP_NUM_THREADS": "1"}
        done = subprocess.run(
            [sys.executable, str(site / "bin" / "rfpp"), *arguments],
            cwd=empty, env=environment, capture_output=True, text=True, timeout=300,
        )  # fmt: skip
        assert done.returncode == code, done.stdout + done.stderr
        return done.stdout + done.stderr

    run.folder, run.site = empty, site
    return run


def pip(verb: str, *arguments: str) -> None:
    """Without the network: neither libraries nor what builds is fetched."""
    command = [sys.executable, "-m", "pip", verb, "--quiet", "--no-deps", "--no-index", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_file_travels(wheel):
    kinds = {
        "rfpp": ("**/*.py", "py.typed", "evaluation/report/pages/*", "serve/addon/*.toml"),
        "conf": ("**/*.yaml",),
        "launch": ("*.py",),
        "data/models": ("*/*",),
    }
    files = {
        f"{CARRIED[folder]}/{path.relative_to(ROOT / folder)}"
        for folder, patterns in kinds.items()
        for pattern in patterns
        for path in (ROOT / folder).glob(pattern)
    }
    assert len(files) > 250
    assert {name for name in zipfile.ZipFile(wheel).namelist() if name.startswith("rfpp/")} == files


def test_a_scene_is_rendered_by_the_network_that_comes_along(installed):
    installed("render", f"scene={ROOT}/data/scenes/cornell_box.json", "cameras=[0]", "resolution=32", "device=cpu")
    assert (installed.folder / "data" / "renders" / "cornell_box_0.png").is_file()


def test_type_checkers_know_the_public_names(installed, tmp_path):
    (tmp_path / "client.py").write_text(
        "from rfpp import Camera, Renderer, load_scene\n"
        "renderer = Renderer.load('radiosity')\n"
        "mean: float = float(renderer.render(['a.json', 'b.glb'], resolution=(64, 32)).mean())\n"
        "view = Camera(position=(0, -2, 1), look_at=(0, 0, 0), fov=40)\n"
        "for name, images in renderer.render_lights(load_scene('a.json', up='y'), 32).items():\n"
        "    print(name.upper(), images.shape, view.fov + mean)\n"
        "renderer.render(3)\n"
        "view.fog\n"
    )
    command = [sys.executable, "-m", "mypy", "--strict", "--follow-imports=silent", "client.py"]
    environment = os.environ | {"MYPYPATH": str(installed.site)}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    errors = re.findall(r"^client.py:(\d+): .*\[([\w-]+)\]$", done.stdout, re.MULTILINE)
    assert errors == [("7", "arg-type"), ("8", "attr-defined")], done.stdout


def test_every_command_is_listed(installed):
    listed = {line.split()[0] for line in installed("--help").splitlines()[2:]}
    assert listed == {path.stem for path in (ROOT / "launch").glob("*.py")}


def test_a_command_finds_its_configuration(installed):
    said = installed("train", "--help")
    assert said.startswith("Train a network")
    assert "# optimizer steps" in said
    assert re.search(r"experiment= +ablation, ", said)


def test_another_projects_commit_is_not_taken_for_its_own(installed):
    asked = "from rfpp.training.tracking import code_version; print(code_version())"
    command = [sys.executable, "-c", asked]
    environment = os.environ | {"PYTHONPATH": str(installed.site)}
    said = subprocess.run(command, cwd=installed.folder, env=environment, capture_output=True, text=True, check=True)
    assert said.stdout == "None\n"
