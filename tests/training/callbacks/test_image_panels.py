"""Panels of validation scenes: which pictures there are, in what order, and where they go."""

import numpy as np
import pytest
from networks import network
from PIL import Image
from trainers import RecordingModule, StillTrainer, batch_of

from rfpp.training.callbacks.image_panels import ImagePanels, pictures
from rfpp.training.tracking.run_logger import RunLogger


@pytest.fixture(scope="module")
def net():
    return network("experiment=ablation")


def batch_for(net, *sizes):
    return batch_of(*sizes, channels=3 + 3 + 1, pixels=16) if net.gbuffer_channels else batch_of(*sizes)


def test_a_row_has_reference_prediction_error_albedo_and_every_bounce(net):
    batch = batch_for(net, [6, 3])
    row = pictures(net, batch, batch.image)
    assert list(row["panels"]) == ["reference", "prediction", "blue: too dark, red: too bright", "albedo"]
    np.testing.assert_array_equal(row["panels"]["reference"], row["panels"]["prediction"])
    bounces = [f"after {k} bounces" for k in range(net.iterations + 1)]
    assert list(row["bounces"]) == [*bounces, "reference"]


def test_sheets_have_a_row_for_each_of_the_first_scenes_and_are_logged(net, tmp_path):
    logger = RunLogger("run", tmp_path)
    trainer = StillTrainer(global_step=7, loggers=[logger])
    module, callback = RecordingModule(network=net), ImagePanels(str(tmp_path / "panels"), scenes=2)
    heights = []
    for count in (1, 3):
        callback.on_validation_start(trainer, module)
        for index in range(count):
            batch = batch_for(net, [6, 3])
            callback.on_validation_batch_end(trainer, module, {"radiance": batch.image}, batch, index)
        callback.on_validation_end(trainer, module)
        with Image.open(tmp_path / "panels" / "panels-000007.png") as sheet:
            heights.append(sheet.height)
    assert heights[0] < heights[1] < 2 * heights[0]  # two rows under one line of captions
    names = {"panels-000007.png", "bounces-000007.png"}
    assert {path.name for path in (tmp_path / "panels").iterdir()} == names
    journal = (tmp_path / "tracking" / "journal.jsonl").read_text()
    assert all(f"panels/{name}" in journal for name in names)
