"""The table of `benchmark=gpu` in Markdown.

python -m rfpp.benchmark.gpu_table data/results/gpu.csv --into docs/results.md
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rfpp.benchmark.cost.rows import read_rows
from rfpp.benchmark.gpu import NEEDED
from rfpp.errors import UserError
from rfpp.files import write_atomically

#: What stands before and after the table in a file that holds it.
BEGIN, END = "<!-- made by rfpp.benchmark.gpu_table -->", "<!-- end of what was made -->"
#: Networks that are compared, by their names in conf/benchmark/gpu.yaml: baseline, and what is better or not.
BASELINE, OURS = "renderformer", "rfpp"

Row = Mapping[str, Any]


def table(rows: Sequence[Row]) -> str:
    """Markdown: for each thing measured of both networks at the same size a line with seconds, memory and their ratios.

    Cards, and commits, are not compared with each other: each has lines of its own.

    Raises:
        UserError: nothing was measured of both.
    """
    measured: dict[str, list[Row]] = {}
    for row in rows:
        measured.setdefault(f"{row['hardware']}, torch {row['torch']}, commit {row['commit']}", []).append(row)
    made = [
        "\n".join([*lines, "", f"*{where}: medians; `launch/benchmark.py benchmark=gpu`.*"])
        for where, of in measured.items()
        if (lines := _lines(of))
    ]
    if not made:
        raise UserError(f"nothing was measured of both {BASELINE} and {OURS}: run benchmark=gpu further")
    return "\n\n".join(made)


def _lines(rows: Sequence[Row]) -> list[str]:
    """Of one card and commit; none where nothing was measured of both networks."""
    ours = {_what(row): row for row in rows if row["network"] == OURS}
    quantities = list(dict.fromkeys(row["quantity"] for row in rows))
    lines = []
    for row in sorted(rows, key=lambda r: (quantities.index(r["quantity"]), int(r["resolution"]), int(r["triangles"]))):
        other = ours.get(_what(row))
        if row["network"] != BASELINE or other is None or row["quantity"] in ("encode", "view"):
            continue
        cells = [_cell(row), _cell(other), _ratio(row, other, "seconds", "{:.1f} ×"), _memory(row, other)]
        side = f"{row['resolution']}²"
        lines.append(f"| {_name(row)} | {int(row['triangles']):,} | {side} | {' | '.join(cells)} |")
    header = "| base, bf16, one view | triangles | pixels | RenderFormer | RenderFormer++ | speed | memory |"
    return [header, "|---|---|---|---|---|---|---|", *lines] if lines else []


def _what(row: Row) -> tuple[str, ...]:
    return tuple(
        row[name] for name in ("quantity", "size", "compiled", "triangles", "objects", "views", "resolution", "scenes")
    )


def _name(row: Row) -> str:
    names = {
        "training_step": "training step",
        "checkpointed_training_step": "training step, blocks recomputed",
        "least_memory_training_step": "training step, least memory",
    }
    name = names.get(row["quantity"], row["quantity"])
    return f"{name}, compiled" if row["compiled"] == "True" else name


def _cell(row: Row) -> str:
    if not row["seconds"]:
        return row["status"]
    gigabytes = f", {float(row['peak_GB']):.1f} GB" if row["peak_GB"] else ""
    return f"{1000 * float(row['seconds']):.0f} ms{gigabytes}"


def _ratio(row: Row, other: Row, column: str, text: str) -> str:
    return text.format(float(row[column]) / float(other[column])) if row[column] and other[column] else ""


def _memory(row: Row, other: Row) -> str:
    if not row["peak_GB"] or not other["peak_GB"]:
        return ""
    return f"{100 * (float(other['peak_GB']) / float(row['peak_GB']) - 1):+.0f}%".replace("-", "−")


def insert(text: str, made: str) -> str:
    """The text with `made` between its marks. Raises UserError where it has none."""
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise UserError(f"no place for the table: put the lines {BEGIN} and {END} there")
    return f"{before}{begin}\n\n{made}\n\n{end}{after}"


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rows", type=Path, help="what launch/benchmark.py benchmark=gpu output=… has written")
    parser.add_argument("--into", type=Path, help="a Markdown file with a place for the table; none: print it")
    given = parser.parse_args(arguments)
    try:
        made = table(read_rows(given.rows, NEEDED, "gpu"))
        if given.into is None:
            print(made)
        else:
            write_atomically(given.into, insert(given.into.read_text(encoding="utf-8"), made).encode())
    except UserError as error:
        parser.exit(1, f"error: {error}\n")


if __name__ == "__main__":
    main()
