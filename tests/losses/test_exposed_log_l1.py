import pytest
import torch

from rfpp.imaging.radiance import log_encode
from rfpp.losses.log_l1 import ExposedLogL1, log_l1

LOSS = ExposedLogL1([8, 64], 0.05)


def room(dark: float) -> torch.Tensor:
    """Half of it bright, half of it nearly dark."""
    return torch.full((1, 3, 8, 8), 1.0).index_fill(3, torch.arange(4), dark)


def test_without_exposures_it_is_log_l1():
    torch.testing.assert_close(ExposedLogL1([], 1.0)(room(0.1), room(0.2)), log_l1(log_encode(room(0.1)), room(0.2)))


def test_a_halo_in_the_dark_counts_more_than_as_much_light_in_the_bright():
    halo, brighter = room(0.01), room(0.0)
    brighter[..., 4:] += 0.01
    alone, both = (ExposedLogL1(exposures, 0.05) for exposures in ([], [8, 64]))
    ratios = [float(loss(halo, room(0.0)) / loss(brighter, room(0.0))) for loss in (alone, both)]
    assert ratios[0] == pytest.approx(2, rel=0.02)  # log10(1 + x) bends by then
    assert ratios[1] > 5


def test_exposures_do_not_depend_on_the_unit_of_light():
    alone = ExposedLogL1([], 0.0)
    of_dark = [LOSS(s * room(0.1), s * room(0.2)) - alone(s * room(0.1), s * room(0.2)) for s in (1.0, 100.0)]
    torch.testing.assert_close(*of_dark)
