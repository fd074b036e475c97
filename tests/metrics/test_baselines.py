import pytest
import torch

from rfpp.imaging.radiance import log_encode
from rfpp.metrics.baselines import (
    CHANNELS,
    AlbedoTimesConstant,
    DirectLight,
    DirectLightAndReflections,
    MeanImage,
)


def _only(albedo: torch.Tensor) -> dict[str, torch.Tensor]:
    return {"albedo": albedo}


def _albedo(seed: int, n: int = 4, size: int = 20) -> torch.Tensor:
    albedo = torch.rand(n, 3, size, size, generator=torch.Generator().manual_seed(seed))
    albedo[:, :, :5] = 0  # nothing hit
    return albedo


def test_mean_image_is_the_mean_of_log_radiance() -> None:
    images = [torch.rand(2, 3, 8, 8, generator=torch.Generator().manual_seed(seed)) for seed in range(3)]
    fitted = MeanImage().fit((_only(image), image) for image in images)
    prediction = fitted.predict(_only(torch.zeros(5, 3, 8, 8)))
    expected = log_encode(torch.cat(images)).mean(dim=0)
    torch.testing.assert_close(log_encode(prediction), expected.expand(5, 3, 8, 8))


@pytest.mark.parametrize("constant", [0.03, 0.6, 7.0])
def test_the_constant_is_recovered(constant: float) -> None:
    fitted = AlbedoTimesConstant().fit((_only(_albedo(seed)), constant * _albedo(seed)) for seed in range(3))
    assert fitted.constant == pytest.approx(constant, rel=0.01)


def test_direct_light_is_reflected_by_both_lobes() -> None:
    gbuffer = {name: _albedo(seed) for seed, name in enumerate(CHANNELS)}
    expected = _albedo(0) * _albedo(2) + _albedo(1) * _albedo(3)
    torch.testing.assert_close(DirectLight().predict(gbuffer), expected)
    torch.testing.assert_close(DirectLightAndReflections().predict(gbuffer), expected + _albedo(1) * _albedo(4))
