"""The image head: a dense prediction transformer (Ranftl et al. 2021) with SiLU, as RenderFormer uses it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, cast

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from rfpp.model.layers.autocast import as_multiplied, in_float32

LEVELS = 4
#: Where training starts: about the mean of log10(1 + radiance). At zero, ELU's flat side would swallow the gradient.
INITIAL_LOG_RADIANCE = 0.1


class DPTHead(nn.Module):
    """Four feature maps of the patch grid → log10(1 + radiance) at pixel resolution, float32.

    The maps are resampled to 4, 2, 1 and 1/2 times the patch grid: with 4×4 patches the finest is exactly the
    image, with RenderFormer's 8×8 it is half of it; never above it.

    The output passes through ELU(α = 10⁻³), as in RenderFormer.

    Args:
        width: Channels of the incoming features.
        level_channels: Channels of the four resampled maps, finest first.
        channels: Channels of the fused maps.
        patch_size: Pixels along a patch's side, at least 4.
    """

    def __init__(self, width: int, level_channels: Sequence[int], channels: int, patch_size: int):
        super().__init__()
        if patch_size < 4:
            raise ValueError(f"patches of {patch_size} pixels: the head's finest level would exceed the image")
        fine, half, _, coarse = level_channels
        self.project = nn.ModuleList(nn.Conv2d(width, c, 1) for c in level_channels)
        self.resample = nn.ModuleList(
            [
                nn.ConvTranspose2d(fine, fine, 4, stride=4),
                nn.ConvTranspose2d(half, half, 2, stride=2),
                nn.Identity(),
                HalvingConv(coarse, coarse, 3, stride=2, padding=1),
            ]
        )
        self.to_common = nn.ModuleList(nn.Conv2d(c, channels, 3, padding=1, bias=False) for c in level_channels)
        self.fuse = nn.ModuleList(FusionBlock(channels, has_skip=level < LEVELS - 1) for level in range(LEVELS))
        self.smooth = nn.Conv2d(channels, channels // 2, 3, padding=1)
        self.out = nn.Sequential(
            nn.Conv2d(channels // 2, channels // 4, 3, padding=1), nn.SiLU(), nn.Conv2d(channels // 4, 3, 1)
        )
        nn.init.constant_(cast(Tensor, self.out[-1].bias), INITIAL_LOG_RADIANCE)

    def forward(
        self, features: Sequence[Float[Tensor, "n c h w"]], height: int, width: int
    ) -> Float[Tensor, "n 3 height width"]:
        levels = [
            common(resample(project(f)))
            for f, project, resample, common in zip(features, self.project, self.resample, self.to_common, strict=True)
        ]
        x = self.fuse[3](levels[3], None, levels[2].shape[-2:])
        x = self.fuse[2](x, levels[2], levels[1].shape[-2:])
        x = self.fuse[1](x, levels[1], levels[0].shape[-2:])
        x = self.fuse[0](x, levels[0], (height, width))
        x = self.out[:-1](_resize(self.smooth(x), (height, width)))
        with in_float32(x):  # bfloat16's eight bits are too few for an image
            return _elu(self.out[-1](x.float()))


class HalvingConv(nn.Conv2d):
    """A convolution of stride 2 that may be given a single pixel.

    A zero beside it says the same as padding does, but oneDNN then takes another kernel: the one for a single pixel
    leaves uninitialized memory in the bfloat16 gradient of the weights that no pixel meets (PyTorch 2.13, CPU).
    """

    def forward(self, x: Float[Tensor, "n c h w"]) -> Float[Tensor, "n d h2 w2"]:
        if x.shape[-2:] == (1, 1):
            x = F.pad(x, (0, 1, 0, 1))
        return super().forward(x)


class FusionBlock(nn.Module):
    """Fusion of a finer level with the coarser sum, refined and enlarged to the next level's size."""

    def __init__(self, channels: int, has_skip: bool):
        super().__init__()
        self.refine_skip = ResidualConvUnit(channels) if has_skip else None
        self.refine = ResidualConvUnit(channels)
        self.out = nn.Conv2d(channels, channels, 1)

    def forward(self, x: Tensor, skip: Tensor | None, size: tuple[int, int]) -> Tensor:
        if self.refine_skip is not None:
            x = x + self.refine_skip(skip)
        enlarged: Tensor = self.out(_resize(self.refine(x), size))
        return enlarged


class ResidualConvUnit(nn.Module):
    """x + conv(silu(conv(silu(x))))."""

    def __init__(self, channels: int):
        super().__init__()
        self.conv1 = nn.Conv2d(channels, channels, 3, padding=1)
        self.conv2 = nn.Conv2d(channels, channels, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        return x + _convolved(self.conv2, _convolved(self.conv1, x))


def _convolved(conv: nn.Conv2d, x: Float[Tensor, "n c h w"]) -> Float[Tensor, "n d h w"]:
    """Return conv(silu(x))."""
    if torch.compiler.is_compiling():  # which decides for itself what to keep
        out: Tensor = conv(F.silu(x))
        return out
    return _silu_conv(x, conv.weight, conv.bias, conv.padding)


class _SiLUConv(torch.autograd.Function):
    """conv(silu(x)), which keeps x alone: half the memory of the head's largest maps."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, bias: Tensor, padding: tuple[int, int]) -> Tensor:
        ctx.save_for_backward(x, weight)
        ctx.padding = padding
        x, weight, bias = (as_multiplied(of) for of in (F.silu(x), weight, bias))
        return F.conv2d(x, weight, bias, padding=padding)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        x, weight = ctx.saved_tensors
        grads = torch.ops.aten.convolution_backward(
            grad, F.silu(x).to(grad.dtype), weight.to(grad.dtype), [len(weight)], (1, 1), ctx.padding, (1, 1), False,
            (0, 0), 1, (True, *ctx.needs_input_grad[1:3]),
        )  # fmt: skip
        of_weights = (None if of is None else of.to(weight.dtype) for of in grads[1:])
        return torch.ops.aten.silu_backward(grads[0].to(x.dtype), x), *of_weights, None


_silu_conv: Callable[..., Tensor] = _SiLUConv.apply  # torch's has no types


class _ELU(torch.autograd.Function):
    """ELU(α = 10⁻³) whose gradient does not vanish below zero.

    There the true slope is at most α, so a pixel that has turned black would hardly recover. A gradient that asks for
    more light is therefore passed on undamped.
    """

    ALPHA = 1e-3

    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        ctx.save_for_backward(x)
        return F.elu(x, alpha=_ELU.ALPHA)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> Tensor:
        (x,) = ctx.saved_tensors
        slope = torch.where((x > 0) | (grad < 0), 1.0, _ELU.ALPHA * x.clamp(max=0).exp())
        return grad * slope


_elu: Callable[..., Tensor] = _ELU.apply  # torch's has no types


def _resize(x: Tensor, size: tuple[int, int]) -> Tensor:
    if x.shape[-2:] == tuple(size):
        return x
    return F.interpolate(x, size=tuple(size), mode="bilinear", align_corners=True)
