import io
import math
import re
from dataclasses import replace

import pytest
from rich.console import Console

from rfpp.evaluation.measuring.buckets import bucketed
from rfpp.evaluation.measuring.confidence import Estimate, split_estimates
from rfpp.evaluation.tables.terminal import results_table
from rfpp.metrics.image import METRICS


def _bold_numbers(text: str) -> list[str]:
    return re.findall(r"\x1b\[1;32m *([\d.]+)", text)


def _terminal_text(means, buckets=(), width=160) -> str:
    stream = io.StringIO()
    console = Console(file=stream, width=width, force_terminal=True, color_system="standard")
    console.print(results_table(means, buckets))
    return stream.getvalue()


def _sure(value: float) -> Estimate:
    return Estimate(value, value, value, 3)


def test_best_is_bold_in_the_direction_of_each_metric(scenes, bootstrap) -> None:
    printed = _terminal_text(split_estimates(scenes, bootstrap))
    model, black = [line for line in printed.splitlines() if "model" in line or "black" in line][:2]
    assert _bold_numbers(model) == ["0.3000"]
    assert _bold_numbers(black) == ["35.00"]


def test_the_models_margin_and_the_number_of_scenes_are_shown(scenes, bootstrap) -> None:
    printed = _terminal_text(split_estimates(scenes, bootstrap))
    assert "test, 2 scenes" in printed
    assert printed.count("± 0.1000") == 1  # the interval of the model's log-L1 is [0.2, 0.4]


def test_buckets_stand_beside_their_split(scenes, bootstrap) -> None:
    printed = _terminal_text(
        split_estimates(scenes, bootstrap), bucketed(scenes, {"triangles": [1000, 3000]}, bootstrap)
    )
    assert re.search(r"1000–2999\W+1\W.*0\.4000", printed)
    assert printed.index("test, the model by") < printed.index("train_newviews, 1 scenes")


def test_definitions_with_tone_map_and_epsilon_stand_beneath() -> None:
    printed = _terminal_text({("test", "model"): {"mape": _sure(0.5), "ssim": _sure(0.9)}})
    assert "0.01" in printed
    assert "log2(1 + I)" in printed


def test_nan_is_shown_and_never_best() -> None:
    means = {("test", "model"): {"l1": _sure(math.nan)}, ("test", "black"): {"l1": _sure(0.2)}}
    printed = _terminal_text(means)
    assert "nan" in printed
    assert _bold_numbers(printed) == ["0.2000"]


@pytest.mark.parametrize(("metrics", "width"), [(list(METRICS)[:6], 80), (list(METRICS), 80)])
def test_the_metrics_fit_a_terminal(scenes, bootstrap, metrics, width) -> None:
    values = dict.fromkeys(metrics, 12.3456)
    scenes = [replace(scene, triangles=123456, values=values) for scene in scenes]
    means = split_estimates(scenes, bootstrap) | {("test", "direct light alone"): dict.fromkeys(metrics, _sure(0.1))}
    printed = _terminal_text(means, bucketed(scenes, {"triangles": [10000, 300000]}, bootstrap), width=width)
    assert "…" not in printed
    assert "10000–299999" in printed
    assert "direct light alone" in printed
