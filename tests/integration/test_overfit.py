"""A small network overfits one scene; otherwise something between shard and loss is broken."""

import torch
from marks import requires_blender
from networks import SMALLEST

from rfpp.metrics.image import ImageMetrics


@requires_blender
def test_one_scene_is_overfitted(composed, rendered_data, tmp_path):
    from launch.train import main
    from rfpp.checkpoint.loading import load_network
    from rfpp.evaluation.measuring.evaluate import score
    from rfpp.evaluation.measuring.predictors import NetworkPredictor
    from rfpp.shards.dataset import ShardSplit

    cfg = composed(
        "train", "experiment=quickstart", "debug=overfit", f"data.root={rendered_data}", "datamodule.workers=0",
        "loss.lpips_weight=0.0", *SMALLEST, "steps=300", "trainer.val_check_interval=300",
        f"run_dir={tmp_path}/run", "logger=none",
    )  # fmt: skip
    checkpoint = main.__wrapped__(cfg)
    network, _ = load_network(checkpoint.with_name("last.ckpt"))
    cpu = torch.device("cpu")
    split, metrics = ShardSplit(rendered_data, "train"), ImageMetrics(lpips=None)
    first, *_ = score([NetworkPredictor(network, cpu)], split, metrics, cpu)
    assert first.values["log_l1"] < 0.01
