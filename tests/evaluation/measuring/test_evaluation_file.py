import json
import math
import shutil

import pytest
import torch
from networks import checkpoint_info

from rfpp.errors import UserError
from rfpp.evaluation.measuring.confidence import Estimate
from rfpp.evaluation.measuring.evaluation_file import EVALUATION_FILE, Evaluation, read_evaluations
from rfpp.metrics.image import METRICS
from rfpp.shards.manifest import Manifest

CHECKS = {"ablation": {"test": {"no_operator": 0.5}}, "transport": {"test": {"residual": [0.5], "log_l1": [0.1]}}}


def test_what_is_written_is_read(evaluation, tmp_path) -> None:
    path = evaluation(**CHECKS).write(tmp_path / "new")
    assert path == tmp_path / "new" / EVALUATION_FILE
    assert read_evaluations([path]) == [evaluation(**CHECKS)]


def test_it_describes_checkpoint_data_and_metrics(data_root) -> None:
    means = {("test", "model"): {"mape": Estimate(0.5, 0.4, 0.6, 3)}}
    info = checkpoint_info(method="RenderFormer*", dataset="small_scale", seed=7, steps=123, commit="abc")
    e = Evaluation.of(info, Manifest.load(data_root), torch.device("cpu"), means, **CHECKS)
    assert (e.method, e.trained_on, e.seed, e.steps, e.commit) == ("RenderFormer*", "small_scale", 7, 123, "abc")
    assert (e.data, e.data_manifest) == ("known", Manifest.load(data_root).hash)
    assert e.definitions == {"mape": METRICS["mape"].definition}
    assert (e.ablation, e.transport) == (CHECKS["ablation"], CHECKS["transport"])
    assert e.hardware.endswith(" cores")


def test_the_file_is_strict_json_even_with_nan_and_infinity(evaluation, tmp_path) -> None:
    values = {"psnr": Estimate(math.inf, math.nan, math.inf, 1)}
    path = evaluation(means={("test", "model"): values}).write(tmp_path)
    numbers = json.loads(path.read_text(), parse_constant=pytest.fail)["splits"]["test"]["model"]["psnr"]
    assert numbers["mean"] == "inf"
    back = read_evaluations([path])[0].means["test", "model"]["psnr"]
    assert back.mean == math.inf and math.isnan(back.low)


def test_files_are_found_at_any_depth_and_copies_count_once(evaluation, tmp_path) -> None:
    without_interval = {("test", "model"): {"l1": Estimate(0.1, math.nan, math.nan, 1)}}
    evaluation(means=without_interval).write(tmp_path / "runs" / "a" / "evaluation")
    other = evaluation(seed=1).write(tmp_path / "elsewhere")
    shutil.copytree(tmp_path / "runs" / "a", tmp_path / "runs" / "artifacts")
    assert [e.seed for e in read_evaluations([tmp_path / "runs", other])] == [0, 1]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, r"evaluation\.json: cannot be read \(No such file"),
        ("{", r"evaluation\.json: not an evaluation .*launch/evaluate\.py"),
        ('{"method": "x", "splits": {}}', r"evaluation\.json: not an evaluation"),
        ('{"splits": {"test": {"model": {"l1": {"mean": 1}}}}}', r"evaluation\.json: not an evaluation"),
        ("[]", r"evaluation\.json: not an evaluation"),
    ],
)
def test_a_bad_file_is_one_line(tmp_path, content, message) -> None:
    path = tmp_path / EVALUATION_FILE
    if content is not None:
        path.write_text(content)
    with pytest.raises(UserError, match=message) as error:
        read_evaluations([path])
    assert "\n" not in str(error.value)


def test_a_folder_without_any_is_named(tmp_path) -> None:
    with pytest.raises(UserError, match=r"no evaluation\.json in this folder: make one with launch/evaluate\.py"):
        read_evaluations([tmp_path])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"level": 0.2}, r"RenderFormer\+\+ \(trained on small_scale, 27000 steps, seed 0.* on 'small_scale' differs"),
        ({"seed": 1, "data_manifest": "newer"}, "the data set 'small_scale' differs from the one in"),
        ({"seed": 1, "definitions": {"mape": "mean |x - y| / |y|"}}, r"the definition of 'mape' has changed"),
        ({"seed": 1, "definitions": {"beauty": "…"}}, r"the definition of 'beauty' has changed"),
    ],
)
def test_what_is_not_comparable_is_refused(evaluation, tmp_path, changes, message) -> None:
    first, second = evaluation().write(tmp_path / "a"), evaluation(**changes).write(tmp_path / "b")
    with pytest.raises(UserError, match=message) as error:
        read_evaluations([first, second])
    assert str(second) in str(error.value)
