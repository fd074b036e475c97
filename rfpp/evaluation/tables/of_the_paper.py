"""The paper's tables with our numbers beside the paper's, from the records of `launch/evaluate.py`.

python -m rfpp.evaluation.tables data/runs/quickstart/latest/evaluation
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from rfpp.errors import UserError
from rfpp.evaluation.measuring.evaluation_collection import COLLECTION_FILE, read_evaluations, write_collection
from rfpp.evaluation.measuring.evaluation_file import EVALUATION_FILE
from rfpp.evaluation.tables.dot_plot import figure, png
from rfpp.evaluation.tables.formats import write_table
from rfpp.evaluation.tables.paper import TABLE_1, TABLE_2
from rfpp.evaluation.tables.rows import OTHERS, ResultTable, other_table, paper_table
from rfpp.files import write_atomically

TABLES = Path("data/results/tables")

DESCRIPTION = f"""\
Finds every {EVALUATION_FILE} and {COLLECTION_FILE} beneath the given paths and writes, each as .md, .tex and .csv:
  table1, table2   every row of the paper's, its number beside ours or "not run"
  others           evaluations that neither of them has a place for, if there are any; also as a picture, .png"""
EXAMPLE = "example: python -m rfpp.evaluation.tables data/runs/*/*/evaluation"


def write_tables(paths: Sequence[Path], output: Path) -> list[Path]:
    """Write all tables into the folder `output`; returns the files.

    Raises:
        UserError: see `read_evaluations` and `write_table`.
    """
    tables = result_tables(paths)
    files = [file for table in tables for file in write_table(table, output)]
    if tables[-1].name == OTHERS and (made := figure(tables[-1])):
        files.append(write_atomically(output / f"{OTHERS}.png", png(made)))
    return files


def result_tables(paths: Sequence[Path]) -> list[ResultTable]:
    """Table 1, Table 2 and, where it has rows, a table of the other evaluations. Raises UserError."""
    evaluations = read_evaluations(paths)
    of_paper = [paper_table(table, evaluations) for table in (TABLE_1, TABLE_2)]
    others = other_table(evaluations, [e for table in of_paper for e in table.evaluations()])
    return [*of_paper, others] if others.blocks else of_paper


def main(arguments: Sequence[str] | None = None) -> None:
    """The command; `arguments` are those of the command line unless given."""
    parser = argparse.ArgumentParser(
        "python -m rfpp.evaluation.tables",
        description=DESCRIPTION,
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("paths", nargs="+", type=Path, metavar="PATH", help=f"a folder, or an {EVALUATION_FILE}")
    parser.add_argument("--output", default=TABLES, type=Path, metavar="FOLDER", help=f"for the tables ({TABLES})")
    parser.add_argument(
        "--collect", type=Path, metavar="FILE", help=f"also write all evaluations to one {COLLECTION_FILE}"
    )
    chosen = parser.parse_args(arguments)
    try:
        files = write_tables(chosen.paths, chosen.output)
        if chosen.collect:
            files.append(write_collection(read_evaluations(chosen.paths), chosen.collect))
    except UserError as error:
        sys.exit(f"error: {error}")
    print(*files, sep="\n")


if __name__ == "__main__":
    main()
