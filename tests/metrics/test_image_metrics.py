import numpy as np
import pytest
import torch

from rfpp.metrics.image import METRICS, ImageMetrics


@pytest.fixture
def metrics(random_lpips):
    """All of them, of images half of whose light is direct, and whose surfaces are of all kinds."""
    of_all = ImageMetrics(random_lpips, detailed=True)
    return lambda prediction, reference: of_all(prediction, reference, _gbuffer(0.5 * reference))


def _gbuffer(direct: torch.Tensor) -> dict[str, torch.Tensor]:
    """Return the G-buffer of white surfaces under this light; roughness grows from top to bottom."""
    nothing = torch.zeros_like(direct)
    roughness = torch.linspace(0, 1, direct.shape[2])[:, None].expand_as(direct)[:, :1]
    surface = {"albedo": nothing + 1, "specular": nothing, "roughness": roughness, "depth": nothing[:, :1] + 1}
    return {**surface, "direct_diffuse": direct, "direct_glossy": nothing}


def _pair(seed: int = 0, n: int = 3, size: int = 48) -> tuple[torch.Tensor, torch.Tensor]:
    """Smooth HDR images with a few very bright pixels, and noisy versions of them."""
    rng = np.random.default_rng(seed)
    coarse = torch.from_numpy(rng.lognormal(-1.5, 0.8, (n, 3, 6, 6))).float()
    reference = torch.nn.functional.interpolate(coarse, size=(size, size), mode="bilinear")
    reference[:, :, 5, 7] = 300.0
    noise = torch.from_numpy(rng.normal(0, 0.05, reference.shape)).float()
    return (reference + noise).clamp_min(0), reference


def test_better_images_score_better_in_the_stated_direction(metrics) -> None:
    prediction, reference = _pair()
    near = metrics(0.1 * prediction + 0.9 * reference, reference)
    far = metrics(prediction, reference)
    for name, metric in METRICS.items():
        sign = 1 if metric.higher_is_better else -1
        assert (sign * (near[name] - far[name]) > 0).all(), name


def test_values_are_per_image(metrics) -> None:
    prediction, reference = _pair()
    together = metrics(prediction, reference)
    for n in range(3):
        alone = metrics(prediction[n : n + 1], reference[n : n + 1])
        for name in METRICS:
            torch.testing.assert_close(together[name][n : n + 1], alone[name], rtol=1e-4, atol=1e-6)


def test_a_nan_prediction_is_not_hidden(metrics) -> None:
    prediction, reference = _pair(n=1)
    prediction[0, 0, 0, 0] = float("nan")
    assert all(value.isnan().all() for value in metrics(prediction, reference).values())


def test_l1_by_bounce_tells_shadow_from_light() -> None:
    reference = torch.full((1, 3, 16, 16), 2.0)
    direct = reference.clone()
    direct[..., 8:] = 0  # a right half in shadow
    wrong_in_light, wrong_in_shadow = reference.clone(), reference.clone()
    wrong_in_light[..., :8] += 1
    wrong_in_shadow[..., 8:] += 1
    metrics = ImageMetrics(lpips=None, detailed=True)
    for prediction, parts in ((wrong_in_light, (0.5, 0.0)), (wrong_in_shadow, (0.0, 0.5))):
        values = metrics(prediction, reference, _gbuffer(direct))
        assert (values["l1_direct"].item(), values["l1_indirect"].item()) == parts
        assert values["l1"].item() == sum(parts)


def test_l1_by_roughness_tells_surfaces_apart() -> None:
    reference = torch.zeros(1, 3, 16, 16)
    gbuffer = _gbuffer(reference)
    for name, kind in (("l1_smooth", 0.1), ("l1_glossy", 0.4), ("l1_rough", 0.9)):
        rows = (gbuffer["roughness"] - kind).abs() < 0.1
        values = ImageMetrics(lpips=None, detailed=True)(rows.float().expand_as(reference), reference, gbuffer)
        assert values[name].item() == values["l1"].item() > 0
    gbuffer["depth"] = torch.zeros_like(gbuffer["depth"])  # no surface at all
    assert ImageMetrics(None, detailed=True)(reference + 1, reference, gbuffer)["l1_rough"].item() == 1


def test_parts_of_l1_add_up_to_it() -> None:
    prediction, reference, direct = torch.rand(3, 2, 3, 16, 16)
    values = ImageMetrics(lpips=None, detailed=True)(prediction, reference, _gbuffer(direct))
    for parts in (("l1_direct", "l1_indirect"), ("l1_smooth", "l1_glossy", "l1_rough")):
        torch.testing.assert_close(sum(values[name] for name in parts), values["l1"])
