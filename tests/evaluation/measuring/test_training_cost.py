"""What a run's journal says about the cost of a step."""

import json

from rfpp.evaluation.measuring.training_cost import TrainingCost


def journal(folder, *values: dict) -> None:
    (folder / "tracking").mkdir(exist_ok=True)
    lines = [json.dumps({"kind": "metrics", "time": 0, "step": step, "values": v}) for step, v in enumerate(values)]
    (folder / "tracking" / "journal.jsonl").write_text(
        "\n".join([json.dumps({"kind": "status", "value": "RUNNING"}), *lines, ""])
    )


def test_the_median_step_and_the_most_memory(tmp_path):
    rates = [{"throughput/steps_per_s": rate, "memory/resident": 2.0} for rate in (2.0, 4.0, 0.1)]
    journal(tmp_path, *rates, {"memory/resident": 3.5}, {"train/loss": 1.0})
    assert TrainingCost.of_run(tmp_path) == TrainingCost(0.5, 3.5)


def test_of_a_gpu_what_was_allocated(tmp_path):
    journal(tmp_path, {"throughput/steps_per_s": 8.0, "memory/allocated": 1.0, "memory/peak": 6.0})
    assert TrainingCost.of_run(tmp_path) == TrainingCost(0.125, 6.0)


def test_where_nothing_tells_nothing_is_said(tmp_path):
    assert TrainingCost.of_run(tmp_path) is None
    journal(tmp_path, {"memory/resident": 3.5})
    assert TrainingCost.of_run(tmp_path) is None
