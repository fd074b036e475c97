"""The benchmark of precisions, on a small network and invented images."""

import torch
from networks import checkpoint_info, model_config, network
from small_data import make

from rfpp.benchmark.precision import measure
from rfpp.checkpoint.loading import CHECKPOINT_KEY


def test_each_precision_is_compared_with_float32(tmp_path):
    data = make(tmp_path / "data", splits={"test": 3})
    experiment = "experiment=large_scale"
    info = checkpoint_info(model_config(experiment), resolution=(8, 8))
    torch.save(
        {
            CHECKPOINT_KEY: info.to_dict(),
            "state_dict": {f"network.{k}": v for k, v in network(experiment).state_dict().items()},
        },
        tmp_path / "net.ckpt",
    )
    made = []
    rows = measure(str(tmp_path / "net.ckpt"), str(data.root), "test", 2, "cpu", lambda *n: made.append(n))
    assert made == [(1, 2), (2, 2)]
    exact, *others = rows
    assert exact["difference"] == exact["largest_difference"] == 0
    assert all(0 < row["difference"] < 1e-3 and row["difference"] <= row["largest_difference"] < 0.1 for row in others)
    assert len({row["difference"] for row in others}) == len(others)  # a stage alone, both, and rounded positions
    assert all(row["images"] == 4 and row["log_l1"] > 0 for row in rows)
