import pytest

from rfpp.benchmark.cost import IDENTITY
from rfpp.benchmark.cost_table import main, table
from rfpp.benchmark.csv_rows import read_rows
from rfpp.commands import CONFIG_DIR
from rfpp.errors import UserError

COMMITTED = CONFIG_DIR.parent / "data" / "results" / "gpu.csv"


def row(network, seconds, memory, **changes):
    return {
        "quantity": "training_step", "acceleration": "graphs", "size": "base", "triangles": "1000", "objects": "5",
        "views": "1", "resolution": "64", "scenes": "1", "network": network, "seconds": seconds,
        "peak_GB": memory, "status": "ok" if seconds else "out of memory", "hardware": "a card", "torch": "2",
        "commit": "c0ffee", "device": "cuda",
    } | changes  # fmt: skip


BASELINE, OURS = row("RenderFormer", "0.3", "10"), row("RenderFormer++", "0.1", "4")


def test_both_networks_share_a_line_with_their_ratios():
    markdown = table([BASELINE, OURS])
    assert "| training step, base | 1,000 | 64² | 300 ms, 10.0 GB | 100 ms, 4.0 GB | 3.0 × | −60% |" in markdown
    assert "a card" in markdown and "c0ffee" in markdown


def test_failures_have_no_ratio():
    assert "| out of memory | 100 ms, 4.0 GB |  |  |" in table([row("RenderFormer", "", ""), OURS])


def test_different_cases_are_not_compared():
    with pytest.raises(UserError, match="no case was measured with both networks"):
        table([BASELINE, row("RenderFormer++", "0.1", "4", triangles="2000")])


def test_different_cards_are_not_compared():
    other = [{**r, "hardware": "another card"} for r in (BASELINE, row("RenderFormer++", "0.2", "4"))]
    first, second = table([BASELINE, OURS, *other]).split("*a card")
    assert "| 3.0 × |" in first and "| 1.5 × |" in second and "another card" in second
    assert table([BASELINE, OURS, other[1]]) == table([BASELINE, OURS])


def test_the_command_prints_the_table_of_the_committed_rows(capsys):
    rows = read_rows(COMMITTED, "cost", {*IDENTITY})
    assert all(float(r["of_peak"]) < 1 for r in rows if r["of_peak"])
    markdown = main([str(COMMITTED)])
    assert capsys.readouterr().out == f"{markdown}\n"
    assert "| training step, base | 25,600 | 256² |" in markdown
