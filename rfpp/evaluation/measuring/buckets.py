"""Errors by scene size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

from rfpp.errors import UserError
from rfpp.evaluation.measuring.confidence import Bootstrap, Estimates, estimates
from rfpp.evaluation.measuring.records import MODEL, SceneRecord


@dataclass(frozen=True)
class Bucket:
    """The network's scores on the scenes of a split whose count lies in a range.

    Attributes:
        split: of the scenes.
        counted: "triangles", "objects" or "lights"; every light is an object too.
        start, stop: the range, `start` included and `stop` not; None means without end.
        estimates: by metric name.
    """

    split: str
    counted: str
    start: int
    stop: int | None
    estimates: Estimates

    @property
    def label(self) -> str:
        """The range, e.g. "1000–2999"."""
        return f"≥ {self.start}" if self.stop is None else f"{self.start}–{self.stop - 1}"


def bucketed(records: Sequence[SceneRecord], edges: Mapping[str, Sequence[int]], bootstrap: Bootstrap) -> list[Bucket]:
    """The buckets that hold a scene, by split, count and range; the network's records alone.

    Args:
        edges: "triangles", "objects", "lights" → where one range ends and the next begins.

    Raises:
        UserError: edges that do not increase from a positive number.
    """
    for counted, limits in edges.items():
        if any(low >= high for low, high in pairwise([0, *limits])):
            raise UserError(f"evaluation.buckets.{counted}={list(limits)}: give positive numbers that increase")
    mine = [record for record in records if record.predictor == MODEL]
    buckets = []
    for split in dict.fromkeys(record.split for record in mine):
        for counted, limits in edges.items():
            for start, stop in pairwise([0, *limits, None]):
                within = [r for r in mine if r.split == split and _lies_in(getattr(r, counted), start, stop)]
                if within:
                    buckets.append(Bucket(split, counted, start, stop, estimates(within, bootstrap)))
    return buckets


def _lies_in(count: int, start: int, stop: int | None) -> bool:
    return start <= count and (stop is None or count < stop)
