"""A GPU without the device: shapes, dtypes and devices of what a network does there, and where it would wait."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from unittest.mock import patch

import torch
import torch.nn.functional as F
from hydra.utils import instantiate
from networks import model_config
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode

from rfpp.model.renderformer_pp import RenderFormerPP

GPU = torch.device("cuda:0")
#: What autocast computes in bfloat16, of what networks here use.
_MATRIX_PRODUCTS = (F.linear, F.conv2d, F.conv_transpose2d, torch.conv2d, torch.conv_transpose2d)


@contextmanager
def fake_gpu(autocast: bool = True) -> Iterator[Copies]:
    """Tensors on the GPU have no values here: asking for one, or mixing devices, is an error."""
    copies, driver = Copies(), _WithoutDriver(autocast)
    with patch("torch.autocast", driver.autocast_set), FakeTensorMode(), copies, driver, torch.no_grad():
        yield copies


class Copies(TorchDispatchMode):
    """Remembers copies between host and GPU, those that a program waits for, and the number of kernels."""

    def __init__(self) -> None:
        super().__init__()
        self.made: list[str] = []
        self.waited_for: list[str] = []
        self.kernels = 0

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        kwargs = kwargs or {}
        out = func(*args, **kwargs)
        self.kernels += not func.is_view and func.namespace != "prim"  # which only asks for a device
        if func is torch.ops.aten._to_copy.default and args[0].device != out.device:
            self.made.append(f"{args[0].device} → {out.device} {list(out.shape)}")
            from_host = out.is_cuda and kwargs.get("non_blocking")
            if not from_host:
                self.waited_for.append(f"{args[0].device} → {out.device} {list(out.shape)}")
        return out


class _WithoutDriver(TorchFunctionMode):
    """Replacements for operations of PyTorch that need a driver: autocast, indexing and contiguous copies."""

    def __init__(self, autocast: bool) -> None:
        super().__init__()
        self.autocast = autocast

    @contextmanager
    def autocast_set(self, device_type: str, dtype: torch.dtype | None = None, enabled: bool = True) -> Iterator[None]:
        """In place of torch.autocast."""
        before, self.autocast = self.autocast, enabled
        yield
        self.autocast = before

    def __torch_function__(self, func, types, args=(), kwargs=None):
        if func is torch.Tensor.__getitem__ and args[0].is_cuda:
            return _indexed(*args)
        if func is torch.Tensor.contiguous and args[0].is_cuda:
            return torch.ops.aten.clone.default(*args, **(kwargs or {"memory_format": torch.contiguous_format}))
        if func is F.scaled_dot_product_attention and args[0].is_cuda:  # it asks the driver which kernels there are
            return args[0].new_empty((*args[0].shape[:-1], args[2].shape[-1]))
        if self.autocast and func in _MATRIX_PRODUCTS:
            args = [a.bfloat16() if isinstance(a, torch.Tensor) and a.is_cuda else a for a in args]
        return func(*args, **(kwargs or {}))


def _indexed(x: torch.Tensor, index: object) -> torch.Tensor:
    """x[index], by the operators that this is made of."""
    index = index if isinstance(index, tuple) else (index,)
    dim, gathered = 0, {}
    for number, i in enumerate(index):
        if i is None:
            x, dim = x.unsqueeze(dim), dim + 1
        elif i is Ellipsis:
            dim = x.ndim - sum(later is not None for later in index[number + 1 :])
        elif isinstance(i, int):
            x = x.select(dim, i)
        elif isinstance(i, slice):
            x, dim = torch.ops.aten.slice.Tensor(x, dim, i.start, i.stop, i.step or 1), dim + 1
        else:
            gathered[dim], dim = i, dim + 1
    return torch.ops.aten.index.Tensor(x, [gathered.get(d) for d in range(dim)]) if gathered else x


def network_on(device: torch.device | str, *overrides: str) -> RenderFormerPP:
    """An untrained network of the project's configuration; for a fake GPU inside `fake_gpu`, or on "meta"."""
    if device != GPU:
        with torch.device(device):
            return instantiate(model_config(*overrides), _convert_="all").to(device)
    net = instantiate(model_config(*overrides), _convert_="all")
    for part in net.modules():  # plain tensors: a gradient there would end the process
        for tensors in (part._parameters, part._buffers):
            tensors.update({name: tensor.detach().to(device) for name, tensor in tensors.items() if tensor is not None})
    return net
