"""The plot of costs: exponents, failures, and invalid tables."""

import csv

import numpy as np
import pytest

from rfpp.benchmark.cost.plot import CASE, exponents, figure, main, swept_rows

TRIANGLES = (1_600, 3_200, 12_800, 25_600, 51_200, 80_000)
STEPS = ("training_step", "checkpointed_training_step", "least_memory_training_step")


@pytest.fixture
def table(tmp_path):
    """Table in which RenderFormer is quadratic from 10,000 triangles on and fails at 80,000; the other is linear."""
    rows = []
    for objects in ("50", "20"):
        for n in TRIANGLES:
            for quantity in ("encode", "render", *STEPS):
                for network in ("RenderFormer", "RenderFormer++"):
                    failed = network == "RenderFormer" and n == 80_000
                    seconds = 1e-9 * max(n, 10_000) ** 2 if network == "RenderFormer" else 1e-5 * n
                    rows.append({
                        **CASE, "objects": objects, "triangles": n, "quantity": quantity, "network": network,
                        "status": "out of memory" if failed else "ok", "seconds": "" if failed else seconds,
                        "peak_GB": "" if failed or quantity == "encode" else 1e-4 * n,
                    })  # fmt: skip
    path = tmp_path / "cost.csv"
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    return path


def keep(table, condition):
    header, *lines = table.read_text().splitlines()
    column = header.split(",").index("triangles"), header.split(",").index("objects")
    kept = [line for line in lines if condition(*(int(line.split(",")[c]) for c in column))]
    table.write_text("\n".join([header, *kept]))


def test_exponents_are_those_of_large_cases(table):
    fitted = exponents(swept_rows(table))
    assert fitted == {"RenderFormer": pytest.approx(2), "RenderFormer++": pytest.approx(1)}


def test_the_command_prints_exponents_and_saves_the_plot_beside_the_table(table, capsys):
    assert main([str(table)]) == table.with_suffix(".png")
    assert table.with_suffix(".png").stat().st_size > 10_000
    printed = capsys.readouterr().out
    assert "RenderFormer: view-independent stage from 10,000 to 80,000 triangles: triangles^2.00" in printed
    assert "RenderFormer++: view-independent stage from 10,000 to 80,000 triangles: triangles^1.00" in printed


def test_failures_are_crosses(table):
    quadratic, crosses, linear, none = (line.get_xydata() for line in figure(swept_rows(table)).axes[0].lines)
    assert quadratic[:-1, 1] == pytest.approx([1e-9 * max(n, 10_000) ** 2 for n in TRIANGLES[:-1]])
    assert np.isnan(quadratic[-1, 1])
    assert crosses[:, 0].tolist() == [80_000]
    assert linear[:, 1] == pytest.approx([1e-5 * n for n in TRIANGLES])
    assert len(none) == 0


@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "cannot be read"), ("a,b\n1,2\n", "not a table of benchmark=cost"), ("", "not a table of benchmark=cost")],
)
def test_invalid_tables_are_reported_in_one_line(content, message, tmp_path, capsys):
    path = tmp_path / "other.csv"
    if content is not None:
        path.write_text(content)
    with pytest.raises(SystemExit):
        main([str(path)])
    error = capsys.readouterr().err
    assert message in error and str(path) in error and error.count("\n") == 1


def test_a_table_of_other_cases_is_reported(table, capsys):
    keep(table, lambda triangles, objects: objects == 20)
    with pytest.raises(SystemExit):
        main([str(table)])
    assert "benchmark.groups" in capsys.readouterr().err
