"""The scaling benchmark as a command: two processes are timed, the model is fitted, and clusters are predicted."""

import pytest
from hydra import compose, initialize_config_dir
from networks import SMALLEST

from launch.benchmark import main
from rfpp.commands import CONFIG_DIR

PARTITIONS = ("in order", "by size")


def test_the_model_is_checked_here_and_applied_to_clusters(tmp_path):
    training = [
        "experiment=quickstart", *SMALLEST, "data.resolution=16", "loss.lpips_weight=0",
        "datamodule.batching.scenes_per_step=2",
    ]  # fmt: skip
    overrides = ",".join(f"'{override}'" for override in training)
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        settings = [
            "benchmark=scaling", "benchmark.sample=4", "benchmark.rounds=1", "benchmark.devices=[1,2,8]",
            f"benchmark.checked=[{overrides}]", f"benchmark.predicted=[{overrides}]", f"output={tmp_path}/scaling.csv",
        ]  # fmt: skip
        rows = main.__wrapped__(compose("benchmark", overrides=settings))
    here = [row for row in rows if row["trained_on"] == "this machine"]
    assert [(row["partition"], row["devices"]) for row in here] == [(p, n) for p in PARTITIONS for n in (1, 2)]
    for row in here:
        assert row["measured_s"] > 0
        assert row["step_s"] == pytest.approx(row["compute_s"] + row["waiting_s"] + row["communication_s"])
    assert here[0]["communication_s"] == 0 < here[1]["communication_s"]
    assert here[0]["efficiency"] == 1
    clusters = {row["trained_on"] for row in rows} - {"this machine"}
    assert len(clusters) == 2
    for name in clusters:
        # two scenes divide among two devices at most; then the batch grows with the devices
        for partition in PARTITIONS:
            found = [row for row in rows if (row["trained_on"], row["partition"]) == (name, partition)]
            sizes = [(row["devices"], row["images_per_step"]) for row in found]
            assert sizes == [(1, 4), (2, 4), (1, 2), (2, 4), (8, 16)]
    assert (tmp_path / "scaling.csv").read_text().count("\n") == 1 + len(rows)
