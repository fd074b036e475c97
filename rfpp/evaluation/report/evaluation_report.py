"""report.html: an evaluation as one self-contained page.

launch/evaluate.py makes it; from the files that it left, without rendering again:

python -m rfpp.evaluation.report data/runs/quickstart/latest/evaluation
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from markupsafe import Markup

from rfpp.errors import UserError
from rfpp.evaluation.measuring.buckets import Bucket
from rfpp.evaluation.measuring.confidence import Estimates
from rfpp.evaluation.measuring.number_text import best_value
from rfpp.evaluation.measuring.records import MODEL, SceneRecord
from rfpp.evaluation.report.evaluation_folder import StoredEvaluation
from rfpp.evaluation.report.page import page
from rfpp.evaluation.report.picture_archive import MAX_PIXELS, StoredPicture
from rfpp.evaluation.report.plots import distribution_plot, size_plot
from rfpp.evaluation.report.ranking import RANKED_BY, places, ranking
from rfpp.files import write_atomically
from rfpp.imaging.panels import ERROR_FULL_SCALE, false_colours
from rfpp.metrics.image import METRICS

REPORT_FILE = "report.html"


@dataclass(frozen=True)
class SplitSection:
    """The section of the page on one split.

    Attributes:
        name: of the split.
        scenes: in it.
        means: by predictor and metric.
        best: by metric the best of the means.
        buckets: the model's means by the size of the scene, by what is counted.
        distributions, sizes: a plot per metric: over scenes, by predictor; against triangles, of the model.
    """

    name: str
    scenes: int
    means: Mapping[str, Estimates]
    best: Mapping[str, float]
    buckets: Mapping[str, Sequence[Bucket]]
    distributions: Mapping[str, Markup]
    sizes: Mapping[str, Markup]


@dataclass(frozen=True)
class SceneCard:
    """The card of one scene on the page.

    Attributes:
        record: the model's.
        pictures: by what they show.
        rank, of: its place among the scenes of its split, from 1, the best.
        places: "best", "median", "worst", if it is that.
    """

    record: SceneRecord
    pictures: Mapping[str, StoredPicture]
    rank: int
    of: int
    places: Sequence[str]


def write_report(folder: Path) -> Path:
    """Write report.html into a folder that launch/evaluate.py wrote; returns its path. A function of its files alone.

    Raises:
        UserError: see `StoredEvaluation.read`; or the file cannot be written.
    """
    return write_atomically(folder / REPORT_FILE, report(StoredEvaluation.read(folder)))


def report(stored: StoredEvaluation) -> bytes:
    """The page as UTF-8."""
    sections = [_section(stored, split) for split in stored.scenes]
    cards = [card for split in stored.scenes for card in _cards(stored, split)]
    triangles = [card.record.triangles for card in cards]
    scale = false_colours(np.broadcast_to(np.linspace(0, 1, 128), (8, 128)))
    return page(
        "report.html",
        about=stored.evaluation,
        splits=sections,
        cards=cards,
        scenes=sum(section.scenes for section in sections),
        smallest=min(triangles),
        largest=max(triangles),
        ranked_by=RANKED_BY,
        max_pixels=MAX_PIXELS,
        error_scale=StoredPicture.of(scale),
        error_full_scale=ERROR_FULL_SCALE,
    )


def _section(stored: StoredEvaluation, split: str) -> SplitSection:
    means = {predictor: values for (of, predictor), values in stored.evaluation.means.items() if of == split}
    names = {name: not METRICS[name].higher_is_better for name in stored.evaluation.definitions}
    mine = _of_model(stored, split)
    by_predictor = {who: [s for s in stored.scenes[split] if s.predictor == who] for who in means}
    counted = dict.fromkeys(bucket.counted for bucket in stored.buckets)
    return SplitSection(
        name=split,
        scenes=len(mine),
        means=means,
        best={name: best_value(name, (values[name].mean for values in means.values())) for name in names},
        buckets={what: [b for b in stored.buckets if (b.split, b.counted) == (split, what)] for what in counted},
        distributions={
            name: distribution_plot({who: [s.values[name] for s in of] for who, of in by_predictor.items()}, is_error)
            for name, is_error in names.items()
        },
        sizes={
            name: size_plot([s.triangles for s in mine], [s.values[name] for s in mine], is_error)
            for name, is_error in names.items()
        },
    )


def _cards(stored: StoredEvaluation, split: str) -> Iterator[SceneCard]:
    """Cards of the scenes with pictures, worst first."""
    mine = _of_model(stored, split)
    for rank, index in reversed(list(enumerate(ranking(mine)))):
        if pictures := stored.pictures.get((split, mine[index].scene)):
            named = [place for place, at in places(len(mine)).items() if at == rank]
            yield SceneCard(mine[index], pictures, rank + 1, len(mine), named)


def _of_model(stored: StoredEvaluation, split: str) -> list[SceneRecord]:
    return [scene for scene in stored.scenes[split] if scene.predictor == MODEL]


def main(arguments: Sequence[str] | None = None) -> None:
    """The command; `arguments` are those of the command line unless given."""
    parser = argparse.ArgumentParser(
        "python -m rfpp.evaluation.report",
        description=f"Writes {REPORT_FILE} into folders that launch/evaluate.py wrote, from the files there.",
    )
    parser.add_argument("folders", nargs="+", type=Path, metavar="FOLDER", help="e.g. data/runs/*/*/evaluation")
    try:
        for folder in parser.parse_args(arguments).folders:
            print(write_report(folder))
    except UserError as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
