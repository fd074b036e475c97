from itertools import pairwise

import pytest
import torch

from rfpp.training.schedule import warmup_cosine


def rates(steps, **schedule):
    optimizer = torch.optim.SGD([torch.nn.Parameter(torch.zeros(1))], lr=2.0)
    scheduler = warmup_cosine(optimizer, **schedule)
    out = []
    for _ in range(steps):
        out.append(optimizer.param_groups[0]["lr"])
        optimizer.step()
        scheduler.step()
    return out


def test_rises_linearly_then_falls_to_the_final_fraction():
    lr = rates(101, warmup_steps=10, total_steps=100, final_fraction=0.1)
    assert lr[:10] == pytest.approx([2.0 * (i + 1) / 10 for i in range(10)])
    assert lr[10] == pytest.approx(2.0)
    assert lr[55] == pytest.approx(2.0 * 0.55)  # half way down from 1 to 0.1
    assert lr[100] == pytest.approx(0.2)
    assert all(a >= b for a, b in pairwise(lr[10:]))
