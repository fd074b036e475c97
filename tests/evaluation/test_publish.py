import numpy as np
import pytest
import torch
from edited_scenes import scene
from networks import checkpoint_info, network

from rfpp.checkpoint.loading import CHECKPOINT_KEY, NETWORK_PREFIX
from rfpp.evaluation.publish import main, publish
from rfpp.inference.renderer import Renderer


@pytest.fixture
def run(tmp_path, evaluation):
    """A trained run, evaluated on its own data and on other scenes."""
    info = checkpoint_info(dataset="small_scale", steps=27_000, commit="abcdef123456")
    state = {NETWORK_PREFIX + name: tensor for name, tensor in network().state_dict().items()}
    (tmp_path / "run" / "checkpoints").mkdir(parents=True)
    torch.save({CHECKPOINT_KEY: info.to_dict(), "state_dict": state}, tmp_path / "run" / "checkpoints" / "best.ckpt")
    evaluation(splits=("test",)).write(tmp_path / "run" / "evaluation")
    evaluation(data="shapes", trained_on="small_scale", splits=("test",), level=0.3).write(
        tmp_path / "run" / "evaluation_shapes"
    )
    return tmp_path / "run"


def test_the_folder_renders_like_the_run_and_its_card_has_the_scores(run, tmp_path, capsys):
    notes = tmp_path / "limits.md"
    notes.write_text("## Limits\n\nGlass.\n")
    main([str(run), str(tmp_path / "toy"), "--notes", str(notes)])
    assert capsys.readouterr().out.strip() == str(tmp_path / "toy")
    trained = Renderer.load(run / "checkpoints" / "best.ckpt", "cpu", "bf16")
    published = Renderer.load(tmp_path / "toy", "cpu", "bf16")
    np.testing.assert_array_equal(published.render(scene()), trained.render(scene()))
    card = (tmp_path / "toy" / "README.md").read_text()
    rows = [line for line in card.splitlines() if line.startswith(("| small_scale", "| shapes"))]
    assert [row.split("|")[1].strip() for row in rows] == [
        "small_scale, test (50 scenes): RenderFormer++",
        "small_scale, test (50 scenes): black",
        "shapes, test (50 scenes): RenderFormer++",
        "shapes, test (50 scenes): black",
    ]
    assert "0.1000 (0.0800–0.1200)" in rows[0] and "0.3000 (0.2800–0.3200)" in rows[2]
    assert card.rstrip().endswith("Glass.")


@pytest.mark.parametrize("change", [{"steps": 9}, {"seed": 3}, {"commit": None}, {"method": "RenderFormer"}])
def test_an_evaluation_of_another_checkpoint_is_refused(run, tmp_path, evaluation, change, capsys):
    evaluation(splits=("test",), **change).write(run / "evaluation")
    with pytest.raises(SystemExit) as stop:
        main([str(run), str(tmp_path / "toy")])
    assert f"had {next(iter(change))} " in str(stop.value.code) and "evaluate again" in str(stop.value.code)
    assert not (tmp_path / "toy").exists()


def test_a_missing_file_is_named(run, tmp_path):
    for arguments, named in (
        ([str(tmp_path / "none"), str(tmp_path / "toy")], "best.ckpt"),
        ([str(run), str(tmp_path / "toy"), "--notes", str(tmp_path / "none.md")], "none.md"),
    ):
        with pytest.raises(SystemExit) as stop:
            main(arguments)
        assert named in str(stop.value.code)


def test_a_refinement_is_published_instead_of_the_checkpoint_it_refines(run, tmp_path):
    refined = Renderer.load(run / "checkpoints" / "best.ckpt", "cpu", "fp32")
    with torch.no_grad():
        next(refined.engine.module.decoder.head.parameters()).mul_(2)
    refined.save(run / "refined")
    published = Renderer.load(publish(run, tmp_path / "toy"), "cpu", "bf16")
    expected = Renderer.load(run / "refined", "cpu", "bf16")
    np.testing.assert_array_equal(published.render(scene()), expected.render(scene()))
