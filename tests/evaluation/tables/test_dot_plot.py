"""The picture of a table: every method, the best first, and every seed."""

import numpy as np
import pytest
from matplotlib.image import imread

from rfpp.evaluation.tables.dot_plot import figure, lines
from rfpp.evaluation.tables.of_the_paper import write_tables
from rfpp.evaluation.tables.paper import TABLE_1
from rfpp.evaluation.tables.rows import other_table, paper_table


@pytest.fixture
def table(evaluation):
    """Method "good" with two seeds, "bad" with one, of two lengths, and the baseline; LPIPS alone is plotted."""
    runs = [
        evaluation(data="toys", method="bad", level=0.5),
        evaluation(data="toys", method="good", level=0.1),
        evaluation(data="toys", method="good", level=0.3, seed=1),
        evaluation(data="toys", method="bad", level=0.4, steps=54_000),
    ]
    return other_table(runs, [])


def test_methods_stand_from_best_to_worst(table):
    [(_, rows)] = table.blocks
    assert [line.label for line in lines(rows, "lpips")] == ["good", "bad, 54000 steps", "bad, 27000 steps", "black"]
    assert lines(rows, "ssim")[0].label == "black"  # higher is better
    assert lines(rows, "psnr") == []  # not measured


def test_every_seed_is_a_dot_and_the_interval_a_bar(table):
    [axes] = figure(table).axes
    assert axes.get_yticklabels()[0].get_text() == "good"
    dots = [np.asarray(line.get_xdata()).tolist() for line in axes.lines]
    assert dots == [pytest.approx([0.1, 0.3]), pytest.approx([0.4]), pytest.approx([0.5]), pytest.approx([0.9])]
    [bar] = axes.collections[0].get_segments()
    assert bar[:, 0].tolist() == pytest.approx([0.18, 0.22])
    bottom, top = axes.get_ylim()
    assert bottom > 3 and top < 0  # downwards, nothing cut off


def test_long_names_leave_the_dots_their_room(evaluation):
    made = figure(other_table([evaluation(data="toys", method="RenderFormer++, " + 3 * "known light, ")], []))
    made.draw_without_rendering()
    [axes] = made.axes
    assert axes.get_window_extent().width > 1.5 * made.dpi  # inches


def test_a_table_without_runs_has_no_picture(evaluation):
    assert figure(other_table([], [])) is None
    assert figure(paper_table(TABLE_1, [])) is None


def test_it_stands_beside_the_other_formats(evaluation, tmp_path):
    evaluation(data="toys").write(tmp_path / "run")
    [path] = [file for file in write_tables([tmp_path / "run"], tmp_path / "tables") if file.suffix == ".png"]
    assert path.name == "others.png"
    assert np.ptp(imread(path)[..., :3]) > 0.5
