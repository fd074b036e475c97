"""If one scene cannot be learned by heart, something between shard and loss is broken."""

import pytest
import torch
from marks import requires_blender

from rfpp.metrics.image import ImageMetrics


@requires_blender
@pytest.mark.timeout(900)
def test_one_scene_is_learned_by_heart(composed, rendered_data, tmp_path):
    from launch.train import main
    from rfpp.checkpoint.loading import load_network
    from rfpp.evaluation.measuring.evaluate import score
    from rfpp.evaluation.measuring.predictors import NetworkPredictor
    from rfpp.shards.dataset import ShardSplit

    cfg = composed(
        "train", "experiment=quickstart", "debug=overfit", f"data.root={rendered_data}", "datamodule.workers=0",
        "loss.lpips_weight=0.0", "steps=300",
        "trainer.val_check_interval=300", f"run_dir={tmp_path}/run", f"logger.folder={tmp_path}",
    )  # fmt: skip
    checkpoint = main.__wrapped__(cfg)
    network, _ = load_network(checkpoint.with_name("last.ckpt"))
    cpu = torch.device("cpu")
    split, metrics = ShardSplit(rendered_data, "train"), ImageMetrics(lpips=None)
    first, *_ = score([NetworkPredictor(network, cpu)], split, metrics, cpu)
    assert first.values["log_l1"] < 0.01
