import math

import numpy as np
import pytest

from rfpp.evaluation.measuring.confidence import Estimate, mean_of_parts, mean_of_seeds, split_estimates


def test_every_scene_counts_the_same_however_many_views_it_has(records, bootstrap) -> None:
    means = split_estimates(records, bootstrap)
    assert means["test", "model"]["log_l1"].mean == pytest.approx((0.2 + 0.4) / 2)
    assert means["test", "black"]["log_l1"].mean == pytest.approx((0.5 + 0.7) / 2)
    assert means["test", "model"]["log_l1"].scenes == 2


def test_the_interval_is_that_of_the_normal_approximation_for_many_scenes(bootstrap) -> None:
    values = np.random.default_rng(1).normal(5.0, 2.0, (400, 1))
    (estimate,) = bootstrap(values)
    error = values.std() / math.sqrt(400)
    assert estimate.mean == pytest.approx(values.mean())
    assert estimate.low == pytest.approx(values.mean() - 1.96 * error, abs=0.15 * error)
    assert estimate.high == pytest.approx(values.mean() + 1.96 * error, abs=0.15 * error)


def test_it_resamples_scenes_not_images(records, bootstrap) -> None:
    """Two scenes allow three means only, whatever the number of their views."""
    estimate = split_estimates(records, bootstrap)["test", "model"]["log_l1"]
    assert (estimate.low, estimate.high) == (pytest.approx(0.2), pytest.approx(0.4))


@pytest.mark.filterwarnings("error")
def test_nan_and_infinity_stay_what_they_are(bootstrap) -> None:
    nan, infinite = bootstrap(np.array([[math.nan, math.inf], [1.0, 2.0], [1.0, 3.0]]))
    assert all(math.isnan(value) for value in (nan.mean, nan.low, nan.high))
    assert infinite.mean == infinite.high == math.inf
    assert math.isfinite(infinite.low)


def test_one_scene_has_no_interval(bootstrap) -> None:
    (estimate,) = bootstrap(np.array([[3.0]]))
    assert estimate.mean == 3.0
    assert math.isnan(estimate.low) and math.isnan(estimate.high)


def test_parts_have_equal_weight_and_independent_errors() -> None:
    joined = mean_of_parts([Estimate(1.0, 0.7, 1.3, 10), Estimate(3.0, 2.6, 3.8, 90)])
    assert joined.mean == pytest.approx(2.0)
    assert joined.low == pytest.approx(2.0 - 0.5 / 2)  # √(0.3² + 0.4²) / 2
    assert joined.high == pytest.approx(2.0 + math.hypot(0.3, 0.8) / 2)
    assert joined.scenes == 100


def test_seeds_share_their_scenes_and_do_not_narrow_the_interval() -> None:
    joined = mean_of_seeds([Estimate(1.0, 0.8, 1.2, 10), Estimate(2.0, 1.6, 2.4, 10)])
    assert (joined.mean, joined.low, joined.high, joined.scenes) == pytest.approx((1.5, 1.2, 1.8, 10))
