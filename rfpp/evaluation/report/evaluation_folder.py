"""Read an evaluation's folder and check that its files belong together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rfpp.errors import UserError
from rfpp.evaluation.measuring.buckets import Bucket
from rfpp.evaluation.measuring.csv_files import read_buckets, read_scenes
from rfpp.evaluation.measuring.evaluation_file import EVALUATION_FILE, Evaluation, require_known_metrics
from rfpp.evaluation.measuring.records import MODEL, SceneRecord
from rfpp.evaluation.report.picture_archive import PICTURES_FILE, StoredPictures, read_pictures


@dataclass(frozen=True)
class StoredEvaluation:
    """One checkpoint's evaluation.

    Attributes:
        evaluation: means, and what was evaluated.
        scenes: every predictor's records, by split.
        buckets: the model's means by the size of the scene.
        pictures: of some scenes.
    """

    evaluation: Evaluation
    scenes: Mapping[str, Sequence[SceneRecord]]
    buckets: Sequence[Bucket]
    pictures: StoredPictures

    @classmethod
    def read(cls, folder: Path) -> StoredEvaluation:
        """Read a folder that launch/evaluate.py wrote.

        Raises:
            UserError: naming the file that is absent, damaged, or of another evaluation than evaluation.json.
        """
        evaluation = Evaluation.read(folder / EVALUATION_FILE)
        require_known_metrics(evaluation, folder / EVALUATION_FILE)
        metrics = list(evaluation.definitions)
        splits = dict.fromkeys(split for split, _ in evaluation.means)
        scenes = {split: read_scenes(folder, split, metrics) for split in splits}
        for (split, predictor), values in evaluation.means.items():
            found = sum(scene.predictor == predictor for scene in scenes[split])
            if any(estimate.scenes != found for estimate in values.values()):
                raise _not_together(folder / f"{split}_scenes.csv")
        pictures = read_pictures(folder)
        known = {(split, scene.scene) for split in splits for scene in scenes[split] if scene.predictor == MODEL}
        if not pictures or not pictures.keys() <= known:
            raise _not_together(folder / PICTURES_FILE)
        return cls(evaluation, scenes, read_buckets(folder, metrics), pictures)


def _not_together(path: Path) -> UserError:
    return UserError(f"{path}: not of the same evaluation as {EVALUATION_FILE}: evaluate again with launch/evaluate.py")
