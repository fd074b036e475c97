import json
import math

import pytest
import torch
from networks import checkpoint_info

from rfpp.evaluation.measuring.confidence import Estimate
from rfpp.evaluation.measuring.evaluation_file import EVALUATION_FILE, Evaluation
from rfpp.evaluation.measuring.training_cost import TrainingCost
from rfpp.metrics.image import METRICS
from rfpp.shards.manifest import Manifest
from rfpp.training.tracking.description import hardware


def test_what_is_written_is_read(evaluation, tmp_path) -> None:
    path = evaluation().write(tmp_path / "new")
    assert path == tmp_path / "new" / EVALUATION_FILE
    assert Evaluation.read(path) == evaluation()


def test_cost_is_kept_and_older_files_do_without(evaluation, tmp_path) -> None:
    known = evaluation(cost=TrainingCost(0.5, 2.25))
    path = known.write(tmp_path)
    assert Evaluation.read(path) == known
    content = json.loads(path.read_text())
    assert content.pop("cost") == {"seconds": 0.5, "memory": 2.25}
    path.write_text(json.dumps(content))
    assert Evaluation.read(path) == evaluation()


def test_it_knows_checkpoint_data_and_definitions(data_root) -> None:
    means = {("test", "model"): {"mape": Estimate(0.5, 0.4, 0.6, 3)}}
    info = checkpoint_info(method="RenderFormer*", dataset="small_scale", seed=7, steps=123, commit="abc")
    e = Evaluation.of(info, Manifest.load(data_root), torch.device("cpu"), means)
    assert (e.method, e.trained_on, e.seed, e.steps, e.commit) == ("RenderFormer*", "small_scale", 7, 123, "abc")
    assert (e.data, e.data_manifest) == ("known", Manifest.load(data_root).hash)
    assert e.definitions == {"mape": METRICS["mape"].definition}


def test_the_file_is_strict_json_even_of_nan_and_infinity(evaluation, tmp_path) -> None:
    values = {"psnr": Estimate(math.inf, math.nan, math.inf, 1)}
    path = evaluation(means={("test", "model"): values}).write(tmp_path)
    numbers = json.loads(path.read_text(), parse_constant=pytest.fail)["splits"]["test"]["model"]["psnr"]
    assert numbers["mean"] == "inf"
    back = Evaluation.read(path).means["test", "model"]["psnr"]
    assert back.mean == math.inf and math.isnan(back.low)


def test_the_processor_is_named() -> None:
    assert hardware(torch.device("cpu")).endswith(" cores")
    assert len(hardware(torch.device("cpu")).partition(",")[0]) > 2
