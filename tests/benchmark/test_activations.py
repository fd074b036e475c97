"""What is kept for the backward pass, counted: of a network whose numbers are known, and of the benchmark's rows."""

import pytest
import torch
from hydra import compose, initialize_config_dir
from torch import nn

from launch.benchmark import main
from rfpp.benchmark.activations import kept_for_backward
from rfpp.commands import CONFIG_DIR


class Net(nn.Module):
    def __init__(self):
        super().__init__()
        self.first, self.second = nn.Linear(4, 8), nn.Sequential(nn.Linear(8, 2), nn.Sigmoid())

    def forward(self, x):
        return self.second(self.first(x)) * x[:, :2]


def test_each_storage_counts_once_where_it_is_saved_first():
    net, x = Net(), torch.randn(3, 4)
    kept = kept_for_backward(net, lambda: net(x), ["first", "second"], ["Sigmoid"])
    # the first layer's input, the second's, the sigmoid's output; the product saves two of these again
    assert kept == {("first", "rest"): 4 * 12, ("second", "rest"): 4 * 24, ("second", "Sigmoid"): 4 * 6}
    with torch.no_grad():
        assert kept_for_backward(net, lambda: net(x), [], []) == {}


def test_a_network_is_as_it_was_afterwards():
    net, x = Net(), torch.randn(3, 4)
    kept_for_backward(net, lambda: net(x), ["first"], ["Linear"])
    assert not any(module._forward_hooks or module._forward_pre_hooks for module in net.modules())
    net(x).sum().backward()


def test_rows_add_up_and_repeat_to_the_byte():
    small = ("size=tiny", "benchmark.setting.threads=1", "benchmark.case.triangles=60", "benchmark.case.objects=5",
             "benchmark.case.resolution=16")  # fmt: skip
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        config = compose("benchmark", overrides=["benchmark=activations", *small])
    rows = main.__wrapped__(config)
    figures = [(row["network"], row["part"], row["layer"], row["kept_GB"]) for row in rows]
    for name in ("RenderFormer", "RenderFormer++"):
        *parts, whole = [row for row in rows if row["network"] == name]
        assert whole["part"] == "all"
        assert whole["kept_GB"] == pytest.approx(sum(row["kept_GB"] for row in parts))
        assert {"embedding", "transport", "decoder.blocks", "decoder.head"} <= {row["part"] for row in parts}
    assert [
        tuple(row[n] for n in ("network", "part", "layer", "kept_GB")) for row in main.__wrapped__(config)
    ] == figures
