"""launch/refine.py: radiosity's images learn from references."""

import pytest
import torch
from hydra import compose, initialize_config_dir
from networks import checkpoint_info
from small_data import Constant, make

from rfpp import Renderer
from rfpp.commands import CONFIG_DIR
from rfpp.radiosity.radiosity import Radiosity
from rfpp.shards.dataset import ShardSplit
from rfpp.training.refining import augment, render_views


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """A data set whose reference images are uniformly gray."""
    folder = tmp_path_factory.mktemp("refining") / "gray"
    make(folder, render=Constant(0.3), resolution=16, splits={"train": 4, "validation": 2})
    return folder


def test_views_hold_images_surfaces_and_references(data):
    progress = []
    renderer = Renderer(Radiosity(), checkpoint_info(resolution=(16, 16)))
    views = render_views(renderer, ShardSplit(data, "train"), [(4, 2), (4, 1)], 0, 3, lambda *x: progress.append(x))
    assert len(views) == 3 * 2 and progress == [(0, 3), (1, 3), (2, 3), (3, 3)]
    shapes = {name: tuple(value.shape) for name, value in views[0].items()}
    assert shapes == {"radiance": (3, 16, 16), "reference": (3, 16, 16), "surfaces": (13, 16, 16), "fov": ()}
    assert (views[0]["reference"] == views[0]["reference"][0, 0, 0]).all() and views[0]["radiance"].std() > 0


def test_augmentation_permutes_colors_and_mirrors_the_whole_pixel():
    """Mirrored positions are projected to the pixels where they are stored."""
    generator = torch.Generator().manual_seed(0)
    column, row = torch.meshgrid(torch.linspace(-0.75, 0.75, 4), torch.linspace(0.75, -0.75, 4), indexing="xy")
    pixels = torch.stack([column, row, -torch.ones(4, 4)])  # x to the right, y up, the camera looks along -z
    position = pixels * (1 + torch.rand(4, 4, generator=generator))
    surfaces = torch.rand(13, 4, 4, generator=generator)
    surfaces[7:10], surfaces[10:13] = -position / position.norm(dim=0), position
    light = torch.rand(3, 4, 4, generator=generator)
    view = {"radiance": light, "reference": 2 * light, "surfaces": surfaces}
    orders, depths = set(), set()
    for _ in range(50):
        augmented = augment(view, generator)
        position, is_mirrored = augmented["surfaces"][10:13], not torch.equal(augmented["surfaces"][12], surfaces[12])
        torch.testing.assert_close(position / -position[2], pixels)
        torch.testing.assert_close(augmented["surfaces"][7:10], -position / position.norm(dim=0))
        back = {name: image.flip(-1) if is_mirrored else image for name, image in augmented.items()}
        order = [next(j for j in range(3) if torch.equal(back["radiance"][i], light[j])) for i in range(3)]
        assert torch.equal(back["reference"], 2 * light[order])
        assert torch.equal(back["surfaces"][:7], torch.cat([surfaces[:3][order], surfaces[3:6][order], surfaces[6:7]]))
        orders.add(tuple(order))
        depths.add(is_mirrored)
    assert (len(orders), len(depths)) == (6, 2)


def test_the_command_trains_a_refinement_that_reduces_the_error(data, tmp_path, capsys):
    from launch.refine import main

    settings = [
        "debug=cpu", "logger=none", f"data.root={data}", f"run_dir={tmp_path}/run",
        "radiosity.refinement.widths=[8,8,8]", "refining.steps=60", "refining.images_per_step=4",
        "refining.validate_every_n_steps=30", "refining.schedule.warmup_steps=5",
        "refining.optimizer.lr=0.01", "refining.default_resolution=16",
    ]  # fmt: skip
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        folder = main.__wrapped__(compose("refine", overrides=settings))
    output = capsys.readouterr().out
    before, after = (float(x) for x in output.split("Validation log-L1 ")[1].split(" (")[0].split(" → "))
    assert after < 0.9 * before
    loaded = Renderer.load(folder, "cpu")
    assert (loaded.info.method, loaded.info.steps, loaded.info.dataset) == ("Radiosity, refined", 60, "small")
    assert loaded.engine.module.refinement.out.weight.abs().max() > 0
    assert (tmp_path / "run" / "metrics.csv").is_file()
