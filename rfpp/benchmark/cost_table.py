"""Print the cost of RenderFormer and RenderFormer++ as a Markdown table.

python -m rfpp.benchmark.cost_table data/results/gpu.csv
"""

from __future__ import annotations

from collections.abc import Sequence

from rfpp.benchmark.cost import IDENTITY
from rfpp.benchmark.csv_rows import command, read_rows
from rfpp.errors import UserError

#: Compared networks, the baseline first.
NETWORKS = ("RenderFormer", "RenderFormer++")

_HEADER = "| bf16 | triangles | pixels | RenderFormer | RenderFormer++ | speed | memory |"
#: Measured quantities in the order of the table.
_NAMES = {
    "training_step": "training step",
    "encode": "encoding",
    "view": "view",
}
#: Columns that two rows must share to be compared.
_SHARED = (
    "quantity", "size", "triangles", "objects", "views", "resolution", "scenes", "acceleration", "hardware", "torch",
    "commit",
)  # fmt: skip

Rows = Sequence[dict[str, str]]


def table(rows: Rows) -> str:
    """Return a Markdown table for each machine, PyTorch version and commit.

    Raises:
        UserError: If no case was measured with both networks.
    """
    by_network = [{tuple(row[c] for c in _SHARED): row for row in rows if row["network"] == n} for n in NETWORKS]
    pairs = [(row, by_network[1][key]) for key, row in by_network[0].items() if key in by_network[1]]
    pairs = [(baseline, ours) for baseline, ours in pairs if baseline["quantity"] in _NAMES]
    if not pairs:
        raise UserError("no case was measured with both networks: continue the benchmark")
    order = list(_NAMES)
    pairs.sort(key=lambda p: (order.index(p[0]["quantity"]), int(p[0]["resolution"]), int(p[0]["triangles"])))
    sources: dict[str, list[str]] = {}
    for baseline, ours in pairs:
        source = f"*{ours['hardware']}, torch {ours['torch']}, commit {ours['commit']}: medians.*"
        sources.setdefault(source, []).append(_line(baseline, ours))
    return "\n\n".join("\n".join([_HEADER, 7 * "|---" + "|", *lines, "", s]) for s, lines in sources.items())


def _line(baseline: dict[str, str], ours: dict[str, str]) -> str:
    is_plain = (ours["device"], ours["acceleration"]) == ("cuda", "none")
    name = f"{_NAMES[ours['quantity']]}, {ours['size']}" + (", plain" if is_plain else "")
    speed = memory = ""
    if baseline["seconds"] and ours["seconds"]:
        speed = f"{float(baseline['seconds']) / float(ours['seconds']):.1f} ×"
    if baseline["peak_GB"] and ours["peak_GB"]:
        memory = f"{100 * (float(ours['peak_GB']) / float(baseline['peak_GB']) - 1):+.0f}%".replace("-", "−")
    cells = [f"{int(ours['triangles']):,}", f"{ours['resolution']}²", _cell(baseline), _cell(ours), speed, memory]
    return f"| {' | '.join([name, *cells])} |"


def _cell(row: dict[str, str]) -> str:
    if not row["seconds"]:
        return row["status"]
    gigabytes = f", {float(row['peak_GB']):.1f} GB" if row["peak_GB"] else ""
    seconds = float(row["seconds"])
    return (f"{seconds:.1f} s" if seconds >= 1 else f"{1000 * seconds:.0f} ms") + gigabytes


def main(arguments: Sequence[str] | None = None) -> str:
    """Run the command of the module's docstring."""
    columns = {*IDENTITY, *_SHARED, "seconds", "peak_GB", "status"}
    return command("cost", __doc__, lambda path: table(read_rows(path, "cost", columns)), arguments)


if __name__ == "__main__":
    main()
