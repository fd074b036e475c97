"""What more scenes are worth to a refinement: a curve for each number of them, and its picture."""

import pytest
from networks import checkpoint_info, model_config, network
from PIL import Image
from small_data import Constant, make

from rfpp import Renderer
from rfpp.benchmark import refining_plot
from rfpp.benchmark.refining import measure
from rfpp.commands import composed
from rfpp.evaluation.measuring.csv_files import write_rows

LINEAR = "experiment=quickstart"


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    folder = tmp_path_factory.mktemp("refining")
    make(folder / "grey", render=Constant(0.3), resolution=16, splits={"train": 3, "validation": 1})
    Renderer(network(LINEAR), checkpoint_info(model_config(LINEAR), resolution=(16, 16))).save(folder / "net")
    overrides = [
        LINEAR, "debug=cpu", f"checkpoint={folder}/net", f"data.root={folder}/grey", "refinement.widths=[8,8,8]",
        "refining.steps=20", "refining.images_per_step=2", "refining.validate_every_n_steps=10",
        "refining.samplings=[[1,1]]", f"refining.rendered={folder}/rendered", "refining.schedule.warmup_steps=2",
        "refining.optimizer.lr=0.01",
    ]  # fmt: skip
    turns = []
    found = list(measure(lambda of: composed(of, "refine"), overrides, [1, 2], lambda *turn: turns.append(turn)))
    assert turns == [(1, 2), (2, 2)]
    return found


def test_a_row_for_each_validation_of_each_number_of_scenes(rows):
    assert [(row["scenes"], row["images"], row["step"]) for row in rows] == [
        (1, 2, 10), (1, 2, 20), (2, 4, 10), (2, 4, 20),
    ]  # fmt: skip
    for first, last in (rows[:2], rows[2:]):
        assert 0 < first["minutes"] < last["minutes"]
        assert last["log_l1"] < first["log_l1"] < first["unrefined_log_l1"] == last["unrefined_log_l1"]


def test_they_are_drawn(rows, tmp_path, capsys):
    file = write_rows(tmp_path / "refining.csv", rows)
    refining_plot.main([str(file)])
    assert Image.open(tmp_path / "refining.png").size[0] > 400
    (tmp_path / "other.csv").write_text("scene,first_s\n1,2\n")
    with pytest.raises(SystemExit):
        refining_plot.main([str(tmp_path / "other.csv")])
    assert "other.csv: not a table of benchmark=refining" in capsys.readouterr().err
