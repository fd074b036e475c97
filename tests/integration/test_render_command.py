"""`launch/render.py` with an untrained network and radiosity: files, output and errors."""

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
from edited_scenes import moved, scene
from marks import requires_blender
from networks import checkpoint_info, network
from PIL import Image

from rfpp import Renderer
from rfpp.checkpoint.loading import CHECKPOINT_KEY, NETWORK_PREFIX
from rfpp.commands import CONFIG_DIR
from rfpp.imaging.exr import read_exr
from rfpp.scene.io.loading import load_scene
from rfpp.scene.io.saving import save_scene
from rfpp.scene.spec import Camera

BOX = CONFIG_DIR.parent / "data" / "scenes" / "cornell_box.json"


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    path = tmp_path_factory.mktemp("network") / "tiny.ckpt"
    state = {NETWORK_PREFIX + name: tensor for name, tensor in network().state_dict().items()}
    torch.save({CHECKPOINT_KEY: checkpoint_info(resolution=(16, 16)).to_dict(), "state_dict": state}, path)
    return path


@pytest.fixture
def render(composed, checkpoint, tmp_path, capsys):
    """`render(*overrides)`: the paths returned, and what was printed."""
    from launch.render import main

    def run(*overrides: str) -> tuple[list[Path], str]:
        where = [
            f"checkpoint={checkpoint}",
            "device=cpu",
            "precision=fp32",
            f"output={tmp_path}/out",
            "resolution=null",
        ]
        capsys.readouterr()
        return main.__wrapped__(composed("render", *where, *overrides)), capsys.readouterr().out

    return run


@pytest.fixture
def refused(render, capsys):
    """`refused(*overrides)`: the one line on stderr."""

    def run(*overrides: str, status: int = 1) -> str:
        with pytest.raises(SystemExit) as stop:
            render(*overrides)
        assert stop.value.code == status
        [line] = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]
        return line

    return run


def test_several_scenes_with_layers_and_a_tone_map(render, tmp_path):
    other = save_scene(scene(), tmp_path / "six.json")
    files, said = render(
        f"scene=[{BOX},{other}]", "cameras=[0,1]", "layers=[normal,depth,direct_diffuse]", "tone_map=agx", "exposure=1"
    )
    assert [file.name for file in files] == ["cornell_box_0.exr", "cornell_box_1.exr", "six_0.exr", "six_1.exr"]
    assert "six: 2 views of 16 x 16 in" in said
    expected = Renderer(network(), checkpoint_info()).render(load_scene(other), (16, 16))
    from rfpp.imaging.tone_maps import AgX

    for file, image in zip(files[2:], expected[:2], strict=True):
        layers = read_exr(file)
        assert layers.keys() == {"RGB", "normal.X", "normal.Y", "normal.Z", "depth.Z", "direct_diffuse"}
        np.testing.assert_array_equal(layers["RGB"], image.astype(np.float16))
        np.testing.assert_array_equal(np.asarray(Image.open(file.with_suffix(".png"))), AgX(1.0)(image))
    assert (tmp_path / "out" / "six.yaml").is_file()


def test_layers_of_lights_and_of_bounces_add_up(render, tmp_path):
    [file], _ = render(
        f"scene={save_scene(scene(), tmp_path / 'six.json')}", "checkpoint=radiosity", "lights=separate",
        "bounces=separate", "transports=2", "cameras=[0]", "resolution=16",
    )  # fmt: skip
    layers = read_exr(file)
    np.testing.assert_allclose(layers["light_lamp"] + layers["light_spot"], layers["RGB"], rtol=1e-2, atol=1e-3)
    bounces = [f"bounce_0{number}" for number in (1, 2, 3, 4)]
    assert layers.keys() == {"RGB", "light_lamp", "light_spot", *bounces}
    np.testing.assert_allclose(sum(layers[name] for name in bounces), layers["RGB"], rtol=1e-2, atol=1e-3)
    means = [layers[name].mean(dtype=np.float64) for name in bounces]
    assert all(more > less > 0 for more, less in pairwise(means))


def test_a_camera_may_be_placed(render, refused, tmp_path):
    placed = ["camera.position=[0.3,-1.5,0.2]", "camera.fov=50", "output=" + str(tmp_path / "placed.exr")]
    [file], _ = render(f"scene={BOX}", *placed)
    camera = Camera(position=(0.3, -1.5, 0.2), look_at=(0, 0, 0), fov=50)
    loaded = load_scene(BOX).model_copy(update={"cameras": (camera,)})
    [expected] = Renderer(network(), checkpoint_info()).render(loaded, (16, 16))
    np.testing.assert_allclose(read_exr(file)["RGB"], expected, rtol=2e-3, atol=1e-4)
    assert "look_at equals position" in refused(f"scene={BOX}", "camera.position=[0,0,0]")
    assert "add camera.position=[x,y,z]" in refused(f"scene={BOX}", "camera.fov=50")


def test_transports_are_an_option(render):
    as_trained, never = (render(f"scene={BOX}", "cameras=0", f"transports={n}")[0][0] for n in ("null", 0))
    assert as_trained == never  # the same file
    expected = Renderer(network(), checkpoint_info()).render(load_scene(BOX), (16, 16), transports=0)[0]
    np.testing.assert_array_equal(read_exr(never)["RGB"], expected.astype(np.float16))


def test_output_names_a_single_view_and_several_are_numbered(render, tmp_path):
    files, _ = render(f"scene={BOX}", "cameras=1", "resolution=[8,12]", f"output={tmp_path}/a/one.exr")
    assert files == [tmp_path / "a" / "one.exr"]
    assert read_exr(files[0])["RGB"].shape == (8, 12, 3)
    files, _ = render(f"scene={BOX}", "resolution=8", f"output={tmp_path}/a/one.exr")
    assert [file.name for file in files] == ["one_0.exr", "one_1.exr", "one_2.exr"]


def test_a_turntable_is_resumed(render, tmp_path):
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    film = [f"scene={BOX}", "motion=turntable", "motion.frames=5", "fps=10"]
    files, said = render(*film)
    assert files == [tmp_path / "out" / "cornell_box_turntable.mp4"]
    assert "5 frames of 16 x 16, 5 rendered" in said
    assert imageio_ffmpeg.count_frames_and_secs(str(files[0]))[0] == 5
    before = files[0].read_bytes()
    files, said = render(*film, "tone_map=agx")
    assert "5 frames of 16 x 16, 0 rendered" in said
    assert files[0].read_bytes() != before  # the same frames in another tone map


def test_a_folder_of_numbered_scenes_is_an_animation(render, tmp_path):
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    for number, one in enumerate((scene(), moved(scene()))):
        save_scene(one, tmp_path / "walk" / f"{number}.json")
    files, _ = render(f"scene={tmp_path}/walk", "motion=numbered_scenes", f"output={tmp_path}/walk.mp4")
    assert files == [tmp_path / "walk.mp4"]
    assert imageio_ffmpeg.count_frames_and_secs(str(files[0]))[0] == 2
    assert len(list((tmp_path / "walk_frames").glob("*.exr"))) == 2


@requires_blender
def test_an_animation_with_references_reports_its_flicker(render, tmp_path):
    pytest.importorskip("imageio_ffmpeg")
    keys = {"objects": {"short_box": [{"time": 0, "rotation": [0, 0, 0]}, {"time": 0.5, "rotation": [0, 0, 60]}]}}
    (tmp_path / "turn.json").write_text(json.dumps(keys))
    files, said = render(
        f"scene={BOX}", "motion=keyframes", f"motion.file={tmp_path}/turn.json", "fps=4", "reference=true",
        "reference_settings=preview",
    )  # fmt: skip
    assert [file.name for file in files] == ["cornell_box_turn.mp4"]
    assert "3 path-traced at 16 samples in" in said
    flicker = float(said.split("flicker ")[1].split()[0])
    assert 0 < flicker < 100
    assert (tmp_path / "out" / "cornell_box_turn_comparison.mp4").is_file()
    assert len(list((tmp_path / "out" / "cornell_box_turn_frames" / "reference").glob("*.exr"))) == 3


@requires_blender
def test_a_second_model_is_part_of_the_comparison(render, checkpoint, tmp_path):
    size = {}
    for name, against in (("alone", []), ("both", [f"against={checkpoint}"])):
        out = tmp_path / f"{name}.exr"
        render(f"scene={BOX}", "cameras=0", "reference=true", "reference_settings=preview", f"output={out}", *against)
        size[name] = Image.open(tmp_path / f"{name}_comparison.png").size
    assert size["both"][0] - 4 == 6 / 4 * (size["alone"][0] - 4)  # its picture and its error


ONE = f"scene={BOX}"
WRONG = {
    "an invalid resolution": ([ONE, "resolution=large"], "resolution"),
    "a resolution of no patches": ([ONE, "resolution=18"], "does not divide into patches"),
    "half a resolution": ([ONE, "resolution=[16]"], "resolution"),
    "a missing camera": ([ONE, "cameras=[7]"], "cameras=[7]"),
    "an invalid camera": ([ONE, "cameras=left"], "cameras"),
    "a layer that does not exist": ([ONE, "layers=[normals]"], "'normals' does not exist"),
    "a missing device": ([ONE, "device=abacus"], "device=abacus"),
    "an invalid exposure": ([ONE, "exposure=bright"], "exposure: "),
    "scenes of the same name": ([f"scene=[{BOX},elsewhere/cornell_box.glb]"], "render each separately"),
    "one file for two scenes": ([f"scene=[{BOX},b.json]", "output=a.exr"], "b.json"),
    "a picture for an animation": ([ONE, "motion=turntable", "output=a.exr"], "ends in .mp4"),
    "a video for a picture": ([ONE, "output=a.mp4"], "ends in .exr"),
    "an animation with several cameras": ([ONE, "motion=turntable", "cameras=[0,1]"], "one camera"),
    "an animation without frames": ([ONE, "motion=turntable", "motion.frames=0"], "motion.frames"),
    "an invalid frame rate": ([ONE, "motion=turntable", "fps=0"], "fps"),
    "keyframes without a file": ([ONE, "motion=keyframes"], "motion.file is missing"),
    "keyframes whose file is missing": ([ONE, "motion=keyframes", "motion.file=absent.yaml"], "absent.yaml"),
    "numbered scenes in one file": ([ONE, "motion=numbered_scenes"], "is not a folder"),
    "an unknown preset of references": ([ONE, "reference=true", "reference_settings=best"], "reference_settings=best"),
    "an invalid boolean": ([ONE, "reference=perhaps"], "reference"),
    "a second model without a reference": ([ONE, "against=other.ckpt"], "add reference=true"),
    "a second model for films": ([ONE, "motion=swing", "reference=true", "against=other.ckpt"], "not to animations"),
    "layers of lights in an animation": ([ONE, "motion=turntable", "lights=separate"], "not to animations"),
    "layers of lights of a network": ([ONE, "lights=separate"], "lights: this network's image is not a sum"),
    "layers of bounces of a network": ([ONE, "bounces=separate"], "bounces: this network's image is not a sum"),
    "too many transports": ([ONE, "transports=1000000"], "transports"),
    "no scene": (["scene=[]"], "scene"),
    "a missing scene": (["scene=absent.json"], "absent.json"),
}  # fmt: skip


@pytest.mark.parametrize(("overrides", "named"), WRONG.values(), ids=WRONG.keys())
def test_each_invalid_value_is_one_line_and_writes_nothing(overrides, named, refused, tmp_path):
    typed = named in ("resolution", "motion.frames")  # refused by the type of the setting, before anything is built
    assert named in refused(*overrides, status=2 if typed else 1)
    assert not (tmp_path / "out").exists()
