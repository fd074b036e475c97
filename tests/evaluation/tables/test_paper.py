"""The paper's numbers, against each other and against a few read off the page."""

import numpy as np
import pytest

from rfpp.evaluation.tables.paper import PAPER_METRICS, TABLE_1, TABLE_2


def _row(table, block: int, label: str) -> np.ndarray:
    """[groups, metrics]"""
    (row,) = [row for row in table.blocks[block].rows if row.label == label]
    return np.reshape(row.values, (len(table.groups), len(PAPER_METRICS)))


def test_every_row_has_a_number_for_every_column() -> None:
    for table in (TABLE_1, TABLE_2):
        rows = [row for block in table.blocks for row in block.rows]
        assert {len(row.values) for row in rows} == {len(table.groups) * len(PAPER_METRICS)}
        assert all(0 < value < 1 for row in rows for value in row.values)
    assert sum(len(block.rows) for block in TABLE_1.blocks) == 6
    assert sum(len(block.rows) for block in TABLE_2.blocks) == 10


def test_splits_and_metrics_are_in_the_papers_order() -> None:
    large = dict(zip(TABLE_1.groups, _row(TABLE_1, 1, "RenderFormer++"), strict=True))
    assert dict(zip(PAPER_METRICS, large["Test split"], strict=True)) == {
        "l1": 0.0899, "mape": 0.3294, "lpips": 0.1766, "ssim": 0.7820,
    }  # fmt: skip


def test_table_2_averages_table_1_as_its_docstring_says() -> None:
    both = np.concatenate([_row(TABLE_1, block, "RenderFormer++") for block in (0, 1)]).mean(axis=0)
    assert both[:3] == pytest.approx(_row(TABLE_2, 1, "RenderFormer++ (K=3)")[0, :3], abs=1e-4)
    finetuned = _row(TABLE_1, 0, "RenderFormer*").mean(axis=0)
    assert finetuned == pytest.approx(_row(TABLE_2, 0, "RenderFormer*")[0], abs=1e-4)
