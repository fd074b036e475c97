"""Format metric values for tables."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from rfpp.evaluation.measuring.confidence import Estimate
from rfpp.metrics.image import METRICS

#: Text of a missing number.
EMPTY = "—"

_ABLATIONS = {
    "other_tokens": "with another scene's tokens",
    "other_encoded_tokens": "with another scene's encoded tokens",
    "no_operator": "without the operator",
}


def number_text(name: str, value: float) -> str:
    """Format a value with the number of digits of the metric `name`."""
    return f"{value:.{METRICS[name].decimals}f}"


def interval_text(name: str, value: Estimate | None) -> str:
    """Format an interval, e.g. "0.0076–0.0085"; a dash for a single scene, which has no interval."""
    if value is None or math.isnan(value.margin):
        return EMPTY
    return f"{number_text(name, value.low)}–{number_text(name, value.high)}"


def best_value(name: str, values: Iterable[float]) -> float:
    """Return the best value of the metric `name`; NaN, which equals nothing, if there is none."""
    numbers = [value for value in values if not math.isnan(value)]
    return (max if METRICS[name].higher_is_better else min)(numbers, default=math.nan)


def ablation_text(growth: Mapping[str, float]) -> str:
    """Format ablations, e.g. "log-L1 with another scene's tokens +2%, without the operator +8%"."""
    return "log-L1 " + ", ".join(f"{_ABLATIONS[name]} {value:+.0%}" for name, value in growth.items())
