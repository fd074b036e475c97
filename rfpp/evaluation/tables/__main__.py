"""The paper's tables with our numbers beside the paper's.

python -m rfpp.evaluation.tables data/runs/quickstart/latest/evaluation
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from rfpp.errors import UserError
from rfpp.evaluation.measuring.evaluation_file import EVALUATION_FILE, read_evaluations, write_evaluations
from rfpp.evaluation.tables.files import write_table
from rfpp.evaluation.tables.paper import TABLE_1, TABLE_2
from rfpp.evaluation.tables.rows import ResultTable, other_table, paper_table

TABLES = Path("data/results/tables")

DESCRIPTION = f"""\
Find every {EVALUATION_FILE} in the given paths and write, each as .md, .tex and .csv:
  table1, table2   every row of the paper, its number beside ours or "not run"
  others           evaluations that do not belong in either of them, if any"""
EXAMPLE = "example: python -m rfpp.evaluation.tables data/runs/*/*/evaluation"


def result_tables(paths: Sequence[Path]) -> list[ResultTable]:
    """Build Table 1, Table 2 and, if it has rows, a table of the other evaluations."""
    evaluations = read_evaluations(paths)
    tables = [paper_table(table, evaluations) for table in (TABLE_1, TABLE_2)]
    placed = {id(e) for table in tables for e in table.evaluations()}
    others = [e for e in evaluations if id(e) not in placed]
    return [*tables, other_table(others)] if others else tables


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the tables and print their paths; `arguments` default to the command line's."""
    parser = argparse.ArgumentParser(
        "python -m rfpp.evaluation.tables",
        description=DESCRIPTION,
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("paths", nargs="+", type=Path, metavar="PATH", help=f"a folder, or an {EVALUATION_FILE}")
    parser.add_argument("--output", default=TABLES, type=Path, metavar="FOLDER", help=f"output folder ({TABLES})")
    parser.add_argument(
        "--collect", type=Path, metavar="FILE", help="also write all evaluations into one file, which is a PATH"
    )
    chosen = parser.parse_args(arguments)
    try:
        if chosen.collect is not None:
            print(write_evaluations(read_evaluations(chosen.paths), chosen.collect))
        for table in result_tables(chosen.paths):
            print(*write_table(table, chosen.output), sep="\n")
    except UserError as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
