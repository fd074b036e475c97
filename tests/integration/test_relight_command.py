"""`launch/relight.py`: the lights of a scene are recovered from its own pictures."""

import numpy as np
import pytest
from edited_scenes import scene
from networks import checkpoint_info, network
from PIL import Image

from rfpp import Renderer, load_scene, save_scene
from rfpp.imaging.exr import write_exr
from rfpp.imaging.panels import tone_mapped

FACTORS = {"lamp": np.array([0.5, 1.0, 2.0], np.float32), "spot": np.array([3.0, 1.0, 1.0], np.float32)}


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """Folder with a scene, a network and the scene's pictures under other lights."""
    folder = tmp_path_factory.mktemp("relight")
    Renderer(network(), checkpoint_info(resolution=(16, 16))).save(folder / "network")
    save_scene(scene(), folder / "six.json")
    lights = Renderer.load("radiosity", "cpu", "fp32").render_lights(scene(), 32)
    for view, image in enumerate(sum(FACTORS[name] * images for name, images in lights.items())):
        write_exr(folder / f"{view}.exr", {"RGB": image})
        Image.fromarray(tone_mapped(image, -1.0)).save(folder / f"{view}.png")
    return folder


@pytest.fixture
def relight(composed, kept, tmp_path):
    from launch.relight import main

    def run(*overrides: str):
        settings = [f"scene={kept}/six.json", "device=cpu", "precision=fp32"]
        return main.__wrapped__(composed("relight", *settings, f"output={tmp_path}", *overrides))

    return run


def factors_of(path) -> dict[str, np.ndarray]:
    before, after = ({o.name: np.array(o.material.emissive) for o in s.objects} for s in (scene(), load_scene(path)))
    return {name: after[name] / before[name] for name in FACTORS}


@pytest.mark.parametrize(
    ("targets", "tolerance"),
    [(["target={kept}/0.exr"], 0.01), (["target=[{kept}/1.png,{kept}/2.png]", "cameras=[1,2]", "exposure=-1"], 0.1)],
    ids=["exr", "two png"],
)
def test_the_lights_of_a_picture_are_recovered(relight, kept, tmp_path, capsys, targets, tolerance):
    written = relight(*(target.format(kept=kept) for target in targets))
    for name, factor in factors_of(written).items():
        np.testing.assert_allclose(factor, FACTORS[name], rtol=tolerance, atol=tolerance)
    said = capsys.readouterr().out
    assert "before" in said and "with these lights" in said and "lamp" in said
    assert Image.open(tmp_path / "six_relit.png").width > 5 * 160
    assert (tmp_path / "six_relit_0.exr").is_file()


def test_masked_pixels_are_ignored(relight, kept, tmp_path):
    from rfpp.imaging.exr import read_exr

    image = read_exr(kept / "0.exr")["RGB"].copy()
    mask = np.full((32, 32, 3), 255, np.uint8)
    image[:10], mask[:10] = 50, 0
    Image.fromarray(mask).save(tmp_path / "mask.png")
    written = relight(f"target={write_exr(tmp_path / 'damaged.exr', {'RGB': image})}", f"mask={tmp_path}/mask.png")
    for name, factor in factors_of(written).items():
        np.testing.assert_allclose(factor, FACTORS[name], rtol=0.01, atol=0.01)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ([], "target is missing"),
        (["target={kept}/none.exr"], "none.exr: cannot be read"),
        (["target=[{kept}/0.exr,{kept}/1.exr]", "cameras=[0]"], "2 pictures for cameras"),
        (["target={kept}/0.exr", "cameras=[7]"], "cameras 0…2"),
        (["target={kept}/0.exr", "checkpoint={kept}/network"], "lights: this network's image is not a sum"),
    ],
    ids=["no target", "missing", "cameras", "camera", "network"],
)
def test_errors_are_one_line(relight, kept, capsys, overrides, message):
    with pytest.raises(SystemExit):
        relight(*(one.format(kept=kept) for one in overrides))
    [line] = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]
    assert message in line
