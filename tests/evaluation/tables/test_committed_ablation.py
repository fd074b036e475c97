"""The committed table of the ablation is what its committed records give."""

from pathlib import Path

from rfpp.evaluation.tables.of_the_paper import write_tables

ABLATION = Path(__file__).parents[3] / "data" / "results" / "ablation"


def test_the_table_is_made_of_its_records(tmp_path):
    made = {file.name: file for file in write_tables([ABLATION], tmp_path)}
    for name in ("others.md", "others.csv"):
        assert made[name].read_text() == (ABLATION / name).read_text()
    assert made["others.md"].read_text().count("sd of 3 seeds") == 11
