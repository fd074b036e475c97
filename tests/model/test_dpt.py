import torch

from rfpp.model.dpt import HalvingConv


def gradient(conv: torch.nn.Conv2d, x: torch.Tensor) -> torch.Tensor:
    with torch.autocast("cpu", torch.bfloat16):
        y = conv(x)
    conv.weight.grad = None
    y.float().square().sum().backward()
    return conv.weight.grad


def test_halving_is_a_plain_strided_convolution():
    torch.manual_seed(0)
    conv = HalvingConv(3, 5, 3, stride=2, padding=1)
    for size in ((1, 1), (1, 2), (2, 1), (2, 2), (3, 4)):
        x = torch.randn(2, 3, *size)
        expected = torch.nn.functional.conv2d(x, conv.weight, conv.bias, stride=2, padding=1)
        torch.testing.assert_close(conv(x), expected)


def test_weights_that_a_single_pixel_does_not_meet_have_no_gradient():
    torch.manual_seed(0)
    conv, x = HalvingConv(64, 64, 3, stride=2, padding=1), torch.randn(4, 64, 1, 1)
    unseen = torch.ones(3, 3, dtype=bool)
    unseen[1, 1] = False
    for _ in range(30):
        rubbish = torch.full_like(conv.weight, float("nan"))
        del rubbish  # where the gradient may come to lie
        weight = gradient(conv, x)
        assert (weight[..., unseen] == 0).all()
        assert weight[..., 1, 1].isfinite().all()
