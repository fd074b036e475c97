import numpy as np
import pytest
import torch
from edited_scenes import scene
from networks import checkpoint_info, network

from rfpp.errors import UserError
from rfpp.inference.renderer import Renderer
from rfpp.model.layers.matrix_precision import matrix_dtype

CPU = torch.device("cpu")


@pytest.mark.parametrize(
    ("has", "dtype"),
    [({"avx512_bf16": True}, torch.bfloat16), ({"amx_bf16": True}, torch.bfloat16),
     ({"avx2": True, "amx_bf16": False}, torch.float32), ({}, torch.float32)],
)  # fmt: skip
def test_a_cpu_is_asked_for_its_instructions(monkeypatch, has, dtype):
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: has)
    assert matrix_dtype("auto", CPU) == dtype
    assert matrix_dtype("fp32", CPU) == torch.float32
    assert matrix_dtype("bf16", CPU) == torch.bfloat16


def test_another_precision_is_refused():
    with pytest.raises(UserError, match="precision=fp16: choose from auto, bf16, fp32"):
        matrix_dtype("fp16", CPU)


def test_bfloat16_gives_nearly_the_same_image():
    exact, fast = (
        Renderer(network("experiment=large_scale"), checkpoint_info(), CPU, dtype).render(scene())
        for dtype in (torch.float32, torch.bfloat16)
    )
    difference = np.abs(np.log10(1 + exact) - np.log10(1 + fast))
    assert 0 < difference.mean() < 0.01 * np.log10(1 + exact).std() + 1e-2
    assert not np.array_equal(fast, fast.astype(np.float16).astype(np.float32)), "the image itself has been rounded"
