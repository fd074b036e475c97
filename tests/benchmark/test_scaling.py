"""The scaling benchmark as a command: two processes timed, the model's parts from what they took, clusters asked."""

import pytest
from hydra import compose, initialize_config_dir
from networks import SMALLEST

from launch.benchmark import main
from rfpp.commands import CONFIG_DIR


def test_the_model_is_checked_here_and_asked_about_clusters(tmp_path):
    training = [
        "experiment=quickstart", "model=known_light", *SMALLEST, "data.resolution=16", "loss.lpips_weight=0",
        "datamodule.scenes_per_step=2",
    ]  # fmt: skip
    overrides = ",".join(f"'{override}'" for override in training)
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        settings = [
            "benchmark=scaling", "benchmark.sample=4", "benchmark.rounds=1", "benchmark.devices=[1,2,8]",
            f"benchmark.checked=[{overrides}]", f"benchmark.predicted=[{overrides}]", f"output={tmp_path}/scaling.csv",
        ]  # fmt: skip
        rows = main.__wrapped__(compose("benchmark", overrides=settings))
    here = [row for row in rows if row["trained_on"] == "this machine"]
    assert [(row["dealt"], row["devices"]) for row in here] == [(d, n) for d in ("in order", "by size") for n in (1, 2)]
    for row in here:
        assert row["measured_s"] > 0
        assert row["step_s"] == pytest.approx(row["compute_s"] + row["waiting_s"] + row["communication_s"])
    assert here[0]["communication_s"] == 0 < here[1]["communication_s"]
    clusters = {row["trained_on"] for row in rows} - {"this machine"}
    assert len(clusters) == 2
    for name in clusters:
        # two scenes of two views divide among two devices at most; and then as many devices as there are scenes
        for dealt in ("in order", "by size"):
            theirs = [row for row in rows if (row["trained_on"], row["dealt"]) == (name, dealt)]
            sizes = [(row["devices"], row["images_per_step"]) for row in theirs]
            assert sizes == [(1, 4), (2, 4), (1, 2), (2, 4), (8, 16)]
    assert (tmp_path / "scaling.csv").read_text().count("\n") == 1 + len(rows)
