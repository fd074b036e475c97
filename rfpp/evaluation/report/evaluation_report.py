"""report.html: an evaluation as one self-contained page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from rfpp.evaluation.measuring.confidence import Estimates
from rfpp.evaluation.measuring.evaluation_file import Evaluation
from rfpp.evaluation.measuring.number_text import ablation_text, best_value, interval_text, number_text
from rfpp.evaluation.measuring.records import MODEL, SceneRecord
from rfpp.evaluation.report.pictures import MAX_PIXELS, RANKED_BY, EmbeddedPicture, PicturedScene
from rfpp.files import write_atomically
from rfpp.imaging.panels import ERROR_FULL_SCALE, false_colors
from rfpp.metrics.image import METRICS

REPORT_FILE = "report.html"

_PAGES = Environment(
    loader=PackageLoader("rfpp.evaluation.report", "pages"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
_PAGES.globals.update(
    metrics=METRICS,
    number_text=number_text,
    interval_text=interval_text,
    ablation_text=ablation_text,
    embedded=EmbeddedPicture.of,
)


@dataclass(frozen=True)
class SplitSection:
    """The section of the page about one split.

    Attributes:
        ablation: Growth of log-L1 by ablation; may be empty.
        transport: Residual and log-L1 after each application of the operator; may be empty.
    """

    name: str
    scenes: int
    means: Mapping[str, Estimates]
    best: Mapping[str, float]
    ablation: Mapping[str, float]
    transport: Mapping[str, Sequence[float]]
    pictured: Sequence[PicturedScene]


def write_report(
    evaluation: Evaluation, records: Sequence[SceneRecord], pictured: Sequence[PicturedScene], folder: Path
) -> Path:
    """Write report.html into `folder`; return its path."""
    splits = dict.fromkeys(split for split, _ in evaluation.means)
    text = _PAGES.get_template("report.html").render(
        about=evaluation,
        splits=[_section(split, evaluation, records, pictured) for split in splits],
        ranked_by=RANKED_BY,
        max_pixels=MAX_PIXELS,
        error_scale=false_colors(np.broadcast_to(np.linspace(0, 1, 128), (8, 128))),
        error_full_scale=ERROR_FULL_SCALE,
    )
    return write_atomically(folder / REPORT_FILE, text.encode("utf-8", "replace"))  # names may hold lone surrogates


def _section(
    split: str, evaluation: Evaluation, records: Sequence[SceneRecord], pictured: Sequence[PicturedScene]
) -> SplitSection:
    means = {predictor: values for (of, predictor), values in evaluation.means.items() if of == split}
    model = [record for record in records if (record.split, record.predictor) == (split, MODEL)]
    return SplitSection(
        name=split,
        scenes=len(model),
        means=means,
        best={name: best_value(name, (v[name].mean for v in means.values())) for name in evaluation.definitions},
        ablation=evaluation.ablation.get(split, {}),
        transport=evaluation.transport.get(split, {}),
        pictured=sorted((s for s in pictured if s.record.split == split), key=lambda s: -s.rank),
    )
