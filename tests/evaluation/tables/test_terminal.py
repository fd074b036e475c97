import io
import math
import re

import pytest
from rich.console import Console

from rfpp.evaluation.measuring.confidence import Estimate, split_estimates
from rfpp.evaluation.tables.terminal import results_table
from rfpp.metrics.image import METRICS


def _bold_numbers(text: str) -> list[str]:
    return re.findall(r"\x1b\[1;32m *([\d.]+)", text)


def _terminal_text(means, width=160) -> str:
    stream = io.StringIO()
    console = Console(file=stream, width=width, force_terminal=True, color_system="standard")
    console.print(results_table(means))
    return stream.getvalue()


def _sure(value: float) -> Estimate:
    return Estimate(value, value, value, 3)


def test_best_is_bold_in_the_direction_of_each_metric(records, bootstrap) -> None:
    printed = _terminal_text(split_estimates(records, bootstrap))
    model, black = [line for line in printed.splitlines() if "model" in line or "black" in line][:2]
    assert _bold_numbers(model) == ["0.3000"]
    assert _bold_numbers(black) == ["35.00"]


def test_nan_is_shown_and_never_best() -> None:
    means = {("test", "model"): {"l1": _sure(math.nan)}, ("test", "black"): {"l1": _sure(0.2)}}
    printed = _terminal_text(means)
    assert "nan" in printed
    assert _bold_numbers(printed) == ["0.2000"]


@pytest.mark.parametrize("metrics", [list(METRICS)[:6], list(METRICS)])
def test_the_metrics_fit_80_characters(metrics) -> None:
    values = dict.fromkeys(metrics, _sure(12.3456))
    printed = _terminal_text({("test", "model"): values, ("test", "direct light and reflections"): values}, width=80)
    assert "…" not in printed
    assert "direct light and reflections" in printed
