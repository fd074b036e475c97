"""The plot of costs: the exponent, what could not be measured, and files that are no table of costs."""

import csv

import pytest

from rfpp.benchmark.cost.plot import exponents, figure, main, swept_rows

TRIANGLES = (1_600, 3_200, 12_800, 25_600, 51_200, 80_000)
STEPS = ("training_step", "checkpointed_training_step", "least_memory_training_step")
CONDITIONS = {"device": "cpu", "precision": "bf16-mixed", "compiled": "false", "threads": 2, "torch": "2.13.0"}


@pytest.fixture
def table(tmp_path):
    """RenderFormer quadratic from 10,000 on, and out of memory in the largest case; the other linear."""
    rows = [
        {
            "sweep": sweep, "triangles": n, "quantity": quantity, "network": network, "objects": 50, **CONDITIONS,
            "status": "out of memory" if missing else "ok",
            "seconds": "" if missing else (1e-9 * max(n, 10_000) ** 2 if network == "RenderFormer" else 1e-5 * n),
            "peak_GB": "" if missing or quantity == "encode" else 1e-4 * n,
        }
        for sweep in ("triangles", "objects")
        for n in TRIANGLES
        for quantity in ("encode", "render", *STEPS)
        for network in ("RenderFormer", "RenderFormer++")
        for missing in [network == "RenderFormer" and n == TRIANGLES[-1]]
    ]  # fmt: skip
    path = tmp_path / "cost.csv"
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    return path


def test_the_exponent_is_that_of_the_large_cases(table):
    fitted = exponents(swept_rows(table))
    assert fitted == {"RenderFormer": pytest.approx(2), "RenderFormer++": pytest.approx(1)}


def test_it_is_printed_and_the_plot_stands_beside_the_table(table, capsys):
    assert main([str(table)]) == table.with_suffix(".png")
    assert table.with_suffix(".png").stat().st_size > 10_000
    printed = capsys.readouterr().out
    assert "RenderFormer: view-independent stage from 10,000 to 80,000 triangles: triangles^2.00" in printed
    assert "RenderFormer++: view-independent stage from 10,000 to 80,000 triangles: triangles^1.00" in printed


def test_curves_hold_what_was_measured_and_crosses_what_was_not(table):
    encode = figure(swept_rows(table)).axes[0]
    assert encode.get_xscale() == encode.get_yscale() == "log"
    curves = [line.get_xydata() for line in encode.lines]
    quadratic, missing, linear, nothing = curves
    assert quadratic[:-1, 1] == pytest.approx([1e-9 * max(n, 10_000) ** 2 for n in TRIANGLES[:-1]])
    assert missing[:, 0].tolist() == [80_000]
    assert linear[:, 1] == pytest.approx([1e-5 * n for n in TRIANGLES])
    assert len(nothing) == 0
    legend = [text.get_text() for text in encode.get_legend().get_texts()]
    assert "RenderFormer ∝ triangles^2.00" in legend and "RenderFormer++ ∝ triangles^1.00" in legend


def test_too_few_points_have_no_exponent(table, capsys):
    lines = table.read_text().splitlines()
    table.write_text("\n".join([lines[0], *(line for line in lines if line.startswith("triangles,1600,"))]))
    main([str(table)])
    assert capsys.readouterr().out.count("too few points") == 2


@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "cannot be read"), ("a,b\n1,2\n", "not a table of benchmark=cost"), ("", "not a table of benchmark=cost")],
)
def test_other_files_are_refused_in_one_line(content, message, tmp_path, capsys):
    path = tmp_path / "other.csv"
    if content is not None:
        path.write_text(content)
    with pytest.raises(SystemExit):
        main([str(path)])
    error = capsys.readouterr().err
    assert message in error and str(path) in error and error.count("\n") == 1


def test_a_table_without_the_sweep_says_how_to_get_it(table, capsys):
    lines = table.read_text().splitlines()
    table.write_text("\n".join(line for line in lines if not line.startswith("triangles,")))
    with pytest.raises(SystemExit):
        main([str(table)])
    assert "benchmark.only=[triangles]" in capsys.readouterr().err
