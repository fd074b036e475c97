"""From evaluation.json files to tables, by the command."""

import csv
import re

import pytest

from rfpp.evaluation.tables.__main__ import main, result_tables

TABLES = ("table1", "table2", "others")


@pytest.fixture
def tables(tmp_path):
    """`tables(evaluations)`: write each into a folder and return the tables' texts by file name."""

    def written(*evaluations) -> dict[str, str]:
        for index, e in enumerate(evaluations):
            e.write(tmp_path / "runs" / str(index) / "evaluation")
        main([str(tmp_path / "runs"), "--output", str(tmp_path / "tables")])
        return {file.name: file.read_text() for file in (tmp_path / "tables").iterdir()}

    return written


def _markdown_rows(text: str) -> list[list[str]]:
    lines = [line for line in text.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]


def _csv_rows(text: str, **where: str) -> list[dict[str, str]]:
    rows = csv.DictReader(text.splitlines())
    return [row for row in rows if all(row[key] == value for key, value in where.items())]


def test_our_number_is_below_the_papers_with_its_interval_and_steps(tables, evaluation) -> None:
    rows = _markdown_rows(tables(evaluation())["table1.md"])
    start = next(i for i, row in enumerate(rows) if row[0] == "RenderFormer++")
    paper, ours, interval = rows[start : start + 3]
    assert paper[1:4] == ["paper", "0.0886", "0.1265"]
    assert ours[1:4] == [r"ours \[1\]: 27K of the paper's 500K steps on small\_scale", "0.1000", "0.1000"]
    assert interval[1:4] == ["95% interval", "0.0800–0.1200", "0.0800–0.1200"]
    assert len({len(row) for row in rows}) == 1


def test_every_row_of_the_paper_is_present_and_missing_runs_are_marked(tables, evaluation) -> None:
    texts = tables(evaluation())
    assert texts["table1.md"].count("| paper |") == 6
    assert texts["table1.md"].count("ours: not run") == 5
    assert texts["table2.md"].count("| paper |") == texts["table2.md"].count("ours: not run") == 10
    not_run = _csv_rows(texts["table2.csv"], method="RenderFormer++ w/o TCL", metric="l1")
    assert [(row["paper"], row["ours"], row["steps"]) for row in not_run] == [("0.0883", "", "")]


def test_seeds_are_averaged_with_their_standard_deviation(tables, evaluation) -> None:
    texts = tables(*(evaluation(seed=seed, level=level) for seed, level in enumerate((0.1, 0.2, 0.3))))
    rows = _markdown_rows(texts["table1.md"])
    ours = next(i for i, row in enumerate(rows) if row[1].startswith("ours ") and "27K" in row[1])
    assert rows[ours][2] == "0.2000"
    assert rows[ours + 1][2] == "0.1800–0.2200"
    assert rows[ours + 2][1:3] == ["sd of 3 seeds", "0.1000"]
    assert "seeds 0, 1, 2," in texts["table1.md"]
    (row,) = _csv_rows(texts["table1.csv"], block="Small-scale data set", method="RenderFormer++", metric="l1",
                       columns="Test split")  # fmt: skip
    assert float(row["sd_of_seeds"]) == pytest.approx(0.1)
    assert (row["seeds"], row["scenes"], row["paper"]) == ("0; 1; 2", "50", "0.0861")


@pytest.mark.parametrize("change", [{"steps": 500}, {"commit": "other"}, {"trained_on": "quickstart"}])
def test_trainings_that_differ_in_more_than_their_seed_are_not_averaged(tables, evaluation, change) -> None:
    text = tables(evaluation(), evaluation(seed=1, level=0.3, **change))["table1.md"]
    assert "sd of" not in text
    assert r"ours \[2\]" in text


def test_table_2_is_the_mean_over_both_data_sets_and_splits(tables, evaluation) -> None:
    small, large = (
        evaluation(data=d, trained_on="both", level=v) for d, v in (("small_scale", 0.1), ("large_scale", 0.3))
    )
    texts = tables(small, large)
    (row,) = _csv_rows(texts["table2.csv"], block="Small- and large-scale data sets", method="RenderFormer++ (K=3)",
                       metric="mape")  # fmt: skip
    assert float(row["ours"]) == pytest.approx(0.2)
    assert float(row["high"]) - float(row["ours"]) == pytest.approx(0.01)  # √(4 · 0.02²) / 4
    assert (row["scenes"], row["evaluated_on"]) == ("200", "small_scale; large_scale")


def test_a_row_needs_all_its_data_sets_else_it_moves_to_the_others(tables, evaluation) -> None:
    texts = tables(evaluation("RenderFormer++ w/o TCL"))
    assert "ours [" not in texts["table2.md"].replace("\\", "")
    assert _csv_rows(texts["others.csv"], method="RenderFormer++ w/o TCL", metric="l1")


def test_a_row_needs_all_its_splits(tables, evaluation) -> None:
    texts = tables(evaluation(splits=("test",)))
    assert texts["table1.md"].count("ours: not run") == 6
    assert _markdown_rows(texts["others.md"])[0][2] == "test: L1 ↓"


def test_other_data_has_its_own_table_with_baselines(tables, evaluation) -> None:
    rows = _markdown_rows(tables(evaluation(data="quickstart"))["others.md"])
    assert [row[:3] for row in rows[2:]] == [
        ["**Data set 'quickstart'**", "", ""],
        ["RenderFormer++", r"ours \[1\]: 27K steps on quickstart", "0.1000"],
        ["", "95% interval", "0.0800–0.1200"],
        ["black", "baseline", "0.9000"],
    ]


def test_the_command_prints_its_files(evaluation, tmp_path, capsys) -> None:
    evaluation(data="quickstart").write(tmp_path / "a")
    main([str(tmp_path / "a"), "--output", str(tmp_path / "out")])
    expected = {tmp_path / "out" / f"{table}.{end}" for table in TABLES for end in ("md", "tex", "csv")}
    assert {str(path) for path in expected} == set(capsys.readouterr().out.split())
    assert all(path.is_file() for path in expected)


def test_latex_has_the_numbers_of_markdown_with_its_own_escapes(tables, evaluation) -> None:
    made = tables(evaluation(data="quick_start"))
    latex = made["others.tex"]
    assert r"\textit{Data set 'quick\_start'}" in latex
    assert r"RenderFormer++ & ours [1]: 27K steps on quick\_start & 0.1000" in latex
    assert latex.count(r"\begin{") == latex.count(r"\end{") == 2
    numbers = [cell for row in _markdown_rows(made["others.md"]) for cell in row if cell.startswith("0.")]
    assert numbers and all(number.replace("–", "--") in latex for number in numbers)


def test_collected_evaluations_are_read_in_place_of_their_folders(evaluation, tmp_path, capsys) -> None:
    for seed in (0, 1):
        evaluation(data="quickstart", seed=seed).write(tmp_path / f"run{seed}")
    main([str(tmp_path), "--output", str(tmp_path / "first"), "--collect", str(tmp_path / "all.json")])
    main([str(tmp_path / "all.json"), "--output", str(tmp_path / "second")])
    for file in (tmp_path / "first").iterdir():
        assert file.read_bytes() == (tmp_path / "second" / file.name).read_bytes()
    (tmp_path / "all.json").write_text("[1]")
    with pytest.raises(SystemExit, match=r"all.json: not an evaluation"):
        main([str(tmp_path / "all.json")])


def test_a_bad_path_is_one_line(tmp_path, capsys) -> None:
    with pytest.raises(
        SystemExit, match=r"^error: .*nowhere: cannot be read \(No such file or directory\): correct"
    ) as stop:
        main([str(tmp_path / "nowhere")])
    assert "\n" not in str(stop.value)


def test_every_evaluation_is_in_a_table(evaluation, tmp_path) -> None:
    all_of_them = [
        evaluation(method, data, seed)
        for method in ("RenderFormer++", "RenderFormer++ (K=1)", "mine")
        for data in ("small_scale", "renderformer", "quickstart")
        for seed in (0, 1)
    ]
    for index, e in enumerate(all_of_them):
        e.write(tmp_path / str(index))
    shown = [e for table in result_tables([tmp_path]) for e in table.evaluations()]
    assert len(shown) == len(all_of_them)
