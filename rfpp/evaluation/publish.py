"""Publish a checkpoint as a model folder, with its evaluations in the model card.

python -m rfpp.evaluation.publish data/runs/quickstart/latest data/models/mine
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from rfpp.checkpoint.loading import CheckpointInfo
from rfpp.errors import UserError
from rfpp.evaluation.measuring.evaluation_file import Evaluation, read_evaluations
from rfpp.evaluation.measuring.number_text import interval_text, number_text
from rfpp.evaluation.measuring.records import MODEL
from rfpp.inference.renderer import Renderer

DESCRIPTION = """\
Write the best checkpoint of a training, or the output of launch/refine.py, as a model folder: weights in bfloat16, its
configuration, and a model card with all evaluations in the run's folder."""
EXAMPLE = "example: python -m rfpp.evaluation.publish data/runs/quickstart/latest data/models/mine --notes limits.md"


def publish(run: Path, folder: Path, notes: str = "") -> Path:
    """Write a model folder.

    Raises:
        CheckpointError: If the run has no checkpoint that loads.
        UserError: If there is no evaluation, one belongs to another checkpoint, or the folder cannot be written.
    """
    refined, best = run / "refined", run / "checkpoints" / "best.ckpt"
    renderer = Renderer.load(refined if refined.is_dir() else best, "cpu", "bf16")
    evaluations = read_evaluations([run])
    for evaluation in evaluations:
        _require_same(renderer.info, evaluation)
    measured: dict[str, Mapping[str, str]] = {}
    for evaluation in sorted(evaluations, key=lambda e: e.data != renderer.info.dataset):
        measured |= _rows(evaluation)
    return renderer.save(folder, measured, notes)


def _rows(evaluation: Evaluation) -> dict[str, Mapping[str, str]]:
    """Return a row for every predictor on every split, with intervals."""
    rows = {}
    for (split, predictor), values in evaluation.means.items():
        method = evaluation.method if predictor == MODEL else predictor
        scenes = next(iter(values.values())).scenes
        rows[f"{evaluation.data}, {split} ({scenes} scenes): {method}"] = {
            name: f"{number_text(name, value.mean)} ({interval_text(name, value)})" for name, value in values.items()
        }
    return rows


def _require_same(info: CheckpointInfo, evaluation: Evaluation) -> None:
    facts = {"method": "method", "dataset": "trained_on", "seed": "seed", "steps": "steps", "commit": "commit"}
    for name, theirs in facts.items():
        expected, found = getattr(info, name), getattr(evaluation, theirs)
        if expected != found:
            raise UserError(
                f"evaluation on '{evaluation.data}': its checkpoint had {name} {found!r}, this one has {expected!r}: "
                "evaluate again with launch/evaluate.py"
            )


def main(arguments: Sequence[str] | None = None) -> None:
    """Publish a run; `arguments` default to the command line's."""
    parser = argparse.ArgumentParser(
        "python -m rfpp.evaluation.publish",
        description=DESCRIPTION,
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("run", type=Path, help="folder of a run of launch/train.py or launch/refine.py")
    parser.add_argument("folder", type=Path, help="folder to write")
    parser.add_argument("--notes", type=Path, metavar="FILE", help="Markdown for the card, e.g. known limits")
    chosen = parser.parse_args(arguments)
    try:
        notes = chosen.notes.read_text(encoding="utf-8") if chosen.notes else ""
        print(publish(chosen.run, chosen.folder, notes))
    except OSError as error:
        sys.exit(f"error: {chosen.notes}: cannot be read ({error.strerror}): correct the path")
    except UserError as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
