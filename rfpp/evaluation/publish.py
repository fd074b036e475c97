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
from rfpp.evaluation.measuring.evaluation_collection import read_evaluations
from rfpp.evaluation.measuring.evaluation_file import Evaluation
from rfpp.evaluation.measuring.number_text import interval_text, number_text
from rfpp.evaluation.measuring.records import MODEL
from rfpp.inference.renderer import Renderer

DESCRIPTION = """\
Writes the best checkpoint of a training, or what launch/refine.py made, as safetensors in bfloat16, its configuration,
and a model card with every evaluation that lies in the run's folder, the trivial baselines beside the network."""
EXAMPLE = "example: python -m rfpp.evaluation.publish data/runs/quickstart/latest data/models/mine --notes limits.md"


def publish(run: Path, folder: Path, notes: str = "") -> Path:
    """Write `folder`; returns it.

    Args:
        run: folder of a training that was evaluated, or of a refinement.
        notes: Markdown for the card: what the network cannot do.

    Raises:
        CheckpointError: the run has no network that loads.
        UserError: there is no evaluation, one is of another network, or the folder cannot be written.
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
    """A row for every predictor on every split, numbers with their intervals."""
    rows = {}
    for (split, predictor), values in evaluation.means.items():
        who = evaluation.method if predictor == MODEL else predictor
        scenes = next(iter(values.values())).scenes
        rows[f"{evaluation.data}, {split} ({scenes} scenes): {who}"] = {
            name: f"{number_text(name, value.mean)} ({interval_text(name, value)})" for name, value in values.items()
        }
    return rows


def _require_same(info: CheckpointInfo, evaluation: Evaluation) -> None:
    for name, mine, its in (
        ("method", info.method, evaluation.method),
        ("data set", info.dataset, evaluation.trained_on),
        ("seed", info.seed, evaluation.seed),
        ("steps", info.steps, evaluation.steps),
        ("commit", info.commit, evaluation.commit),
    ):
        if mine != its:
            raise UserError(
                f"evaluation on '{evaluation.data}': of a network with {name} {its!r}, the checkpoint has {mine!r}: "
                "evaluate again with launch/evaluate.py"
            )


def main(arguments: Sequence[str] | None = None) -> None:
    """The command; `arguments` are those of the command line unless given."""
    parser = argparse.ArgumentParser(
        "python -m rfpp.evaluation.publish",
        description=DESCRIPTION,
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("run", type=Path, help="folder of a run, as launch/train.py or launch/refine.py made it")
    parser.add_argument("folder", type=Path, help="folder to write")
    parser.add_argument("--notes", type=Path, metavar="FILE", help="Markdown for the card: what it cannot do")
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
