import json
import math
import shutil

import pytest

from rfpp.errors import UserError
from rfpp.evaluation.measuring.confidence import Estimate
from rfpp.evaluation.measuring.evaluation_collection import COLLECTION_FILE, read_evaluations, write_collection
from rfpp.evaluation.measuring.evaluation_file import EVALUATION_FILE
from rfpp.evaluation.measuring.training_cost import TrainingCost


def test_one_file_holds_many_and_says_once_what_they_share(evaluation, tmp_path) -> None:
    means = {**evaluation().means, ("test", "unfinished"): {"psnr": Estimate(math.inf, 1.0, math.inf, 1)}}
    mine = [
        evaluation(),
        evaluation(seed=1, level=0.3, cost=TrainingCost(0.5, 2.0)),
        evaluation(seed=2, means=means, life={"test": {"no_transport": 0.5}}),
    ]
    path = write_collection(mine, tmp_path / COLLECTION_FILE)
    assert read_evaluations([path]) == read_evaluations([tmp_path]) == mine
    content = json.loads(path.read_text(), parse_constant=pytest.fail)
    assert content["shared"]["data"] == mine[0].data and "seed" not in content["shared"]
    assert [own["seed"] for own in content["evaluations"]] == [0, 1, 2]
    assert all("definitions" not in own for own in content["evaluations"])


def test_a_single_evaluation_can_be_collected(evaluation, tmp_path) -> None:
    assert read_evaluations([write_collection([evaluation()], tmp_path / "one.json")]) == [evaluation()]


def test_an_evaluation_beside_its_collection_counts_once(evaluation, tmp_path) -> None:
    write_collection([evaluation(), evaluation(seed=1)], tmp_path / COLLECTION_FILE)
    evaluation(seed=1).write(tmp_path / "run")
    assert sorted(e.seed for e in read_evaluations([tmp_path])) == [0, 1]


def test_a_damaged_collection_is_one_line(evaluation, tmp_path) -> None:
    path = write_collection([evaluation(), evaluation(seed=1)], tmp_path / COLLECTION_FILE)
    content = json.loads(path.read_text())
    for damaged in ({**content, "shared": []}, {**content, "evaluations": [1]}, {"evaluations": []}):
        path.write_text(json.dumps(damaged))
        with pytest.raises(UserError, match=r"evaluations\.json: not an evaluation"):
            read_evaluations([path])


def test_files_are_found_at_any_depth_and_copies_count_once(evaluation, tmp_path) -> None:
    evaluation().write(tmp_path / "runs" / "a" / "evaluation")
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
    with pytest.raises(UserError, match=r"no evaluation\.json anywhere beneath: make one with launch/evaluate\.py"):
        read_evaluations([tmp_path])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"level": 0.2},
            r"RenderFormer\+\+ \(trained on small_scale, 27000 steps, seed 0.* on 'small_scale' is not the",
        ),
        ({"seed": 1, "data_manifest": "newer"}, "the data set 'small_scale' is not the same here as in"),
        (
            {"seed": 1, "definitions": {"mape": "mean |x - y| / |y|"}},
            r"'mape' is by now another metric .*: evaluate again",
        ),
    ],
)
def test_what_must_not_be_compared_is_refused(evaluation, tmp_path, changes, message) -> None:
    first, second = evaluation().write(tmp_path / "a"), evaluation(**changes).write(tmp_path / "b")
    with pytest.raises(UserError, match=message) as error:
        read_evaluations([first, second])
    assert str(second) in str(error.value)
