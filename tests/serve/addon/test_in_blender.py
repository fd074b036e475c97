"""The add-on, installed from its zip file in Blender, with a server in a process of its own."""

import os
import re
import signal
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from marks import requires_blender

from rfpp import Renderer
from rfpp.imaging.exr import read_exr
from rfpp.reference.cycles import CyclesSettings, render
from rfpp.scene.io.loading import load_scene
from rfpp.scene.spec import Camera
from rfpp.serve.extension import write_extension
from rfpp.serve.scene_renderer import ReceivedScene

pytestmark = requires_blender

ROOT = Path(__file__).parents[3]
NOWHERE = "http://127.0.0.1:9"  # the discard port, on which nothing listens


@pytest.fixture(scope="module")
def server():
    """The address of `rfpp serve`."""
    command = [sys.executable, "-u", "launch/serve.py", "port=0", "device=cpu"]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, env=environment)
    try:
        yield re.match(r"http://\S+", process.stdout.readline())[0]
    finally:
        process.send_signal(signal.SIGINT)
        rest, _ = process.communicate(timeout=60)
    assert rest.endswith("Closed.\n") and process.returncode == 0


@pytest.fixture(scope="module")
def blender(tmp_path_factory):
    """`blender(address, function, *arguments)`: output of a function of `in_blender`."""
    folder = tmp_path_factory.mktemp("blender")
    extension = write_extension(folder)
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    environment["BLENDER_USER_RESOURCES"] = str(folder)

    def run(*arguments: str | Path) -> str:
        program = [sys.executable, str(ROOT / "tests" / "support" / "in_blender.py"), str(extension)]
        done = subprocess.run(
            [*program, *map(str, arguments)], capture_output=True, text=True, timeout=300, env=environment, cwd=folder
        )
        assert done.returncode == 0 and "Traceback" not in done.stderr, done.stdout + done.stderr
        return done.stdout

    return run


def radiance(path: Path) -> np.ndarray:
    """[h, w, 4]"""
    return next(layer for layer in read_exr(path).values() if layer.ndim == 3)


def difference(image: np.ndarray, expected: np.ndarray) -> float:
    return np.abs(image - expected).mean() / expected.mean()


def test_the_picture_equals_that_of_blenders_gltf_export(server, blender, tmp_path):
    said = blender(server, "render_and_export", tmp_path / "sent.exr", tmp_path / "exported.glb")
    assert "Warning: " not in said.replace("Warning: World", "")
    sent = radiance(tmp_path / "sent.exr")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = load_scene(tmp_path / "exported.glb")
    [exported] = Renderer.load("radiosity", "cpu").render(scene, (64, 96))
    assert sent.shape == (64, 96, 4) and (sent[..., 3] == 1).all()
    assert exported.mean() > 0.05
    assert difference(sent[..., :3], exported) < 0.01


def test_shifted_lenses_and_regions(server, blender, tmp_path):
    paths = [tmp_path / f"{name}.exr" for name in ("whole", "shifted", "part")]
    blender(server, "render_parts", *paths)
    whole, shifted, part = (radiance(path)[..., :3] for path in paths)
    rows, columns = round(0.05 * 96), round(0.1 * 96)
    # noise of the light; an offset of one pixel differs several times as much
    assert difference(shifted[:-rows, :-columns], whole[rows:, columns:]) < 0.05
    assert part.shape == (32, 48, 3)
    assert difference(part, whole[:32, 24:72]) < 0.05


def test_alpha_of_a_transparent_film(server, blender, tmp_path):
    blender(server, "render_transparent", tmp_path / "a.exr")
    alpha = radiance(tmp_path / "a.exr")[..., 3]
    assert 0.1 < alpha.mean() < 0.9
    assert alpha[0].max() == 0 and alpha[-1].min() == 1


def test_deviations_are_reported(server, blender, tmp_path):
    said = blender(server, "render_unsupported", tmp_path / "a.exr")
    for line in (
        "Light of the world is omitted: Sky",
        "Materials without a Principled BSDF have their viewport color: Plain",
        "Coats are ignored: Glazed",
        "Normal and bump maps are ignored: Glazed",
        "Inputs computed by nodes have their default value: Roughness of Glazed",
        "Volumes are omitted: Volume",
        "Depth of field is omitted: Camera",
        "Transparent materials are opaque: Glazed",
    ):
        assert f"Warning: {line}" in said
    assert radiance(tmp_path / "a.exr")[..., :3].mean() > 0.05


def test_renders_that_are_impossible_are_one_line(server, blender, tmp_path):
    said = blender(server, "render_orthographic", tmp_path / "a.exr")
    assert "refused: Error: Camera 'Camera' has no perspective: change its Lens Type to Perspective" in said
    said = blender(NOWHERE, "render_without_server")
    assert f"refused: Error: No server at {NOWHERE}: start one with `rfpp serve`" in said
    said = blender("http://192.0.2.7:8700", "render_without_server")
    assert "refused: Error: 'http://192.0.2.7:8700' is not an address of this machine" in said


def test_disabling_the_add_on_leaves_nothing(server, blender):
    said = blender(server, "disable")
    assert "left: [], False, False" in said
    assert "again: True" in said


def test_pictures_are_as_bright_as_in_cycles(server, blender, tmp_path):
    blender(server, "render_beside_cycles", tmp_path / "rfpp.exr", tmp_path / "cycles.exr")
    ours, theirs = (radiance(tmp_path / f"{name}.exr")[..., :3] for name in ("rfpp", "cycles"))
    np.testing.assert_allclose(ours.mean(axis=(0, 1)), theirs.mean(axis=(0, 1)), rtol=0.15)


@pytest.mark.parametrize("kind", ["RECTANGLE", "DISK", "SPOT", "SUN"])
def test_a_light_is_as_bright_as_in_cycles(kind, blender, in_process, tmp_path):
    blender(NOWHERE, "light_in_cycles", kind, tmp_path / "a.exr", tmp_path / "a.glb")
    expected = radiance(tmp_path / "a.exr")[..., :3]
    received = ReceivedScene.read((tmp_path / "a.glb").read_bytes())
    camera = Camera(position=(0, 0, 5), look_at=(0, 0, 0), up=(0, 1, 0), fov=45)
    scene = received.scene.seen_by([received.framing.camera(camera)])
    settings = CyclesSettings(
        samples=256, adaptive_threshold=0.0, denoise=False, max_bounces=0, diffuse_bounces=0, glossy_bounces=0,
        clamp_direct=0.0, clamp_indirect=0.0, caustics=False, blur_glossy=0.0, light_threshold=0.0, filter_width=1.5,
        seed=0, threads=1,
    )  # fmt: skip
    [image] = in_process(render, scene.triangles, scene.c2w, scene.fov, 24, 24, settings)
    lit = image[:12]  # away from the light itself, which Blender's camera sees
    np.testing.assert_allclose(lit.mean(axis=(0, 1)), expected[:12].mean(axis=(0, 1)), rtol=0.05)
    if kind == "SPOT":  # dark beyond the cone, bright within
        assert (np.abs(lit - expected[:12]).mean() < 0.15 * expected[:12].mean()).all()


def test_a_viewport_shows_the_newest_view_in_full(server, blender, tmp_path):
    said = blender(server, "look_in_a_viewport", tmp_path / "seen.npy")
    seen = np.load(tmp_path / "seen.npy")
    assert seen.shape == (54, 96, 4)
    assert "said: Orthographic views are not supported" in said
    assert seen[..., :3].mean() > 0.05
