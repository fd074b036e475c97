"""launch/refine.py and what it is made of: a network's images learn from references, and the network stays as it is."""

import pytest
import torch
from hydra import compose, initialize_config_dir
from networks import checkpoint_info, model_config, network
from small_data import Constant, make

from rfpp import Renderer
from rfpp.checkpoint.loading import load_network
from rfpp.commands import CONFIG_DIR
from rfpp.errors import UserError
from rfpp.shards.dataset import ShardSplit
from rfpp.training.refining.module import Validation
from rfpp.training.refining.rendered_views import RenderedViews, augmented

LINEAR = "experiment=quickstart"
SAMPLINGS = [(4, 2), (4, 1)]


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """A folder with a network and a data set whose images are grey all over."""
    folder = tmp_path_factory.mktemp("refining")
    make(folder / "grey", render=Constant(0.3), resolution=16, splits={"train": 4, "validation": 2})
    Renderer(network(LINEAR), checkpoint_info(model_config(LINEAR), resolution=(16, 16))).save(folder / "net")
    return folder


def rendered(kept, folder, split="train", seed=0, progress=lambda done, total: None) -> RenderedViews:
    stored = ShardSplit(kept / "grey", split)
    return RenderedViews(Renderer.load(kept / "net", precision="fp32"), stored, SAMPLINGS, seed, folder, progress)


class TestRenderedViews:
    def test_holds_images_surfaces_and_references(self, kept, tmp_path):
        views = rendered(kept, tmp_path)
        assert len(views) == 4 * 2
        shapes = {name: tuple(x.shape) for name, x in views[0].items()}
        assert shapes == {"radiance": (3, 16, 16), "reference": (3, 16, 16), "surfaces": (13, 16, 16), "fov": ()}
        assert (views[0]["reference"] == views[0]["reference"][0, 0, 0]).all() and views[0]["radiance"].std() > 0

    def test_renders_nothing_twice_and_goes_on_where_it_was_stopped(self, kept, tmp_path, monkeypatch):
        def stop_after_two(done, total):
            if done == 2:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            rendered(kept, tmp_path, progress=stop_after_two)
        before = {file: file.stat().st_mtime_ns for file in tmp_path.rglob("*.npz")}
        assert len(before) == 2
        first = rendered(kept, tmp_path)
        assert {file: file.stat().st_mtime_ns for file in before} == before
        monkeypatch.setattr(Renderer, "views", None)
        again = rendered(kept, tmp_path)
        assert all(torch.equal(first[3][name], again[3][name]) for name in first[3])

    def test_another_network_or_other_draws_are_rendered_anew(self, kept, tmp_path):
        rendered(kept, tmp_path)
        rendered(kept, tmp_path, seed=1)
        assert len(list(tmp_path.iterdir())) == 2

    def test_a_damaged_file_is_named(self, kept, tmp_path):
        file = rendered(kept, tmp_path).files[1]
        file.write_bytes(file.read_bytes()[:100])
        with pytest.raises(UserError, match=f"{file.name}: is damaged: delete it"):
            rendered(kept, tmp_path)

    def test_so_is_one_with_a_flipped_byte(self, kept, tmp_path):
        views = rendered(kept, tmp_path)
        content = bytearray(views.files[0].read_bytes())
        content[200] ^= 1
        views.files[0].write_bytes(content)
        with pytest.raises(UserError, match=f"{views.files[0].name}: is damaged: delete it"):
            views[0]


def test_augmented_views_show_the_same_surfaces_in_other_colours_and_the_right_way_round():
    """Points in front of the camera are seen where they are, and every other value of a pixel comes along."""
    generator = torch.Generator().manual_seed(0)
    column, row = torch.meshgrid(torch.linspace(-0.75, 0.75, 4), torch.linspace(0.75, -0.75, 4), indexing="xy")
    seen_at = torch.stack([column, row, -torch.ones(4, 4)])  # x to the right, y up, the camera looks along -z
    position = seen_at * (1 + torch.rand(4, 4))
    light, surfaces = torch.rand(3, 4, 4), torch.rand(13, 4, 4)
    surfaces[7:10], surfaces[10:13] = -position / position.norm(dim=0), position
    view = {"radiance": light, "reference": 2 * light, "surfaces": surfaces}
    orders, ways = set(), set()
    for _ in range(50):
        one = augmented(view, generator)
        points = one["surfaces"][10:13]
        torch.testing.assert_close(points / -points[2], seen_at)
        torch.testing.assert_close(one["surfaces"][7:10], -points / points.norm(dim=0))
        # each pixel of the view is known by its depth
        place = [(one["surfaces"][12] == depth).flatten().nonzero().item() for depth in position[2].flatten()]
        back = {name: image.flatten(1)[:, place].view(-1, 4, 4) for name, image in one.items()}
        order = [next(j for j in range(3) if torch.equal(back["radiance"][i], light[j])) for i in range(3)]
        assert torch.equal(back["reference"], 2 * light[order])
        assert torch.equal(back["surfaces"][:3], surfaces[:3][order])
        assert torch.equal(back["surfaces"][3:6], surfaces[3:6][order])
        assert torch.equal(back["surfaces"][6], surfaces[6])
        orders.add(tuple(order))
        ways.add(tuple(place))
    assert (len(orders), len(ways)) == (6, 2)  # as it is and mirrored


def test_the_command_refines_a_network_and_leaves_the_rest_of_it_as_it_was(kept, tmp_path, capsys):
    from launch.refine import main

    settings = [
        LINEAR, "debug=cpu", f"checkpoint={kept}/net", f"data.root={kept}/grey", f"run_dir={tmp_path}/run",
        "refining.steps=60", "refining.images_per_step=4", "refining.validate_every_n_steps=30",
        f"refining.rendered={tmp_path}/rendered", "refinement.widths=[8,8,8]", "refining.schedule.warmup_steps=5",
        "refining.optimizer.lr=0.01",
    ]  # fmt: skip
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        folder = main.__wrapped__(compose("refine", overrides=settings))
    said = " ".join(capsys.readouterr().out.split())
    before, after = (float(x) for x in said.split("Validation log-L1 ")[1].split(" (")[0].split(" → "))
    assert after < 0.9 * before

    old, new = (load_network(of)[0].state_dict() for of in (kept / "net", folder))
    assert all(torch.equal(new[name], weight) for name, weight in old.items())
    assert {name.split(".")[0] for name in new.keys() - old.keys()} == {"refinement"}
    _, info = load_network(folder)
    assert info.method.endswith(", refined")
    assert "60 steps on 8 images of" in (folder / "README.md").read_text()
    assert (tmp_path / "run" / "metrics.csv").is_file()


def test_what_is_learned_by_heart_is_told():
    from launch.refine import _advice

    def validations(*errors):
        return [Validation(500 * n, 1.0 * n, [e, e + 0.002], [0.004, 0.006]) for n, e in enumerate(errors, 1)]

    assert _advice(validations(0.004, 0.003, 0.0030001)) is None
    said = _advice(validations(0.004, 0.003, 0.0035))
    assert "after 1000 steps (0.00400)" in said and "refining.steps=1000" in said
