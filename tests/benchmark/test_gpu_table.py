"""The table of a GPU machine for reading, and that the one on the page of results is that of the committed rows."""

import csv

import pytest

from rfpp.benchmark.cost.rows import read_rows
from rfpp.benchmark.gpu import NEEDED
from rfpp.benchmark.gpu_table import BEGIN, END, insert, main, table
from rfpp.commands import CONFIG_DIR
from rfpp.errors import UserError

ROOT = CONFIG_DIR.parent


def row(network, seconds, memory, **changes):
    return {
        "quantity": "training_step", "size": "base", "compiled": "False", "triangles": "1000", "objects": "5",
        "views": "1", "resolution": "64", "scenes": "1", "network": network, "seconds": seconds, "peak_GB": memory,
        "status": "ok" if seconds else "out of memory", "hardware": "a card", "torch": "2", "commit": "c0ffee",
    } | changes  # fmt: skip


def test_both_networks_stand_in_a_line_with_what_one_is_worth():
    made = table([row("renderformer", "0.3", "10"), row("rfpp", "0.1", "4")])
    assert "| training step | 1,000 | 64² | 300 ms, 10.0 GB | 100 ms, 4.0 GB | 3.0 × | −60% |" in made
    assert "a card" in made and "c0ffee" in made


def test_what_did_not_fit_has_no_ratio():
    made = table([row("renderformer", "", ""), row("rfpp", "0.1", "4")])
    assert "| out of memory | 100 ms, 4.0 GB |  |  |" in made


def test_other_sizes_are_not_compared():
    with pytest.raises(UserError, match="nothing was measured of both"):
        table([row("renderformer", "0.3", "10"), row("rfpp", "0.1", "4", triangles="2000")])


def test_cards_are_not_compared_with_each_other():
    other = {"hardware": "another card"}
    rows = [row("renderformer", "0.3", "10"), row("rfpp", "0.1", "4")]
    made = table([*rows, row("rfpp", "0.2", "4", **other), row("renderformer", "0.3", "10", **other)])
    first, second = made.split("*a card")
    assert "| 3.0 × |" in first and "| 1.5 × |" in second and "another card" in second
    assert table([*rows, row("rfpp", "0.2", "4", **other)]) == table(rows)


def test_the_table_goes_where_its_marks_are(tmp_path):
    text = insert(f"before\n{BEGIN}\nold\n{END}\nafter", "new")
    assert "old" not in text and text.startswith("before") and text.endswith("after") and "new" in text
    with pytest.raises(UserError, match="no place"):
        insert("no marks", "new")


def test_the_table_of_the_results_page_is_that_of_the_committed_rows(tmp_path):
    rows, readme = ROOT / "data" / "results" / "gpu.csv", ROOT / "docs" / "results.md"
    copy = tmp_path / "results.md"
    copy.write_bytes(readme.read_bytes())
    main([str(rows), "--into", str(copy)])
    assert copy.read_text() == readme.read_text(), "make it again with rfpp.benchmark.gpu_table"
    assert all(float(r["of_peak"]) < 1 for r in csv.DictReader(rows.open()) if r["of_peak"])
    assert len(read_rows(rows, NEEDED, "gpu")) > 50
