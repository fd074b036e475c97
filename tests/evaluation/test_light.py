"""Errors of further light: what counts, what does not, and the command that measures them."""

import csv

import numpy as np
import pytest
import torch
from networks import network
from PIL import Image
from small_data import make

from rfpp.evaluation.clean_views import clean_scene
from rfpp.evaluation.light import AS_IT_IS, LightErrors, measure
from rfpp.evaluation.light_summary import main, markdown
from rfpp.evaluation.light_table import COLUMNS, write_light_rows
from rfpp.model.radiosity import UnlearnedRadiosity
from rfpp.shards.stream import ShardSplit

KNOWN = torch.rand(2, 3, 16, 16, generator=torch.Generator().manual_seed(0))
FURTHER = torch.rand(2, 3, 16, 16, generator=torch.Generator().manual_seed(1))


def errors(*images: torch.Tensor) -> LightErrors:
    found = LightErrors()
    for image in images:
        found.add(AS_IT_IS, image, KNOWN, KNOWN + FURTHER)
    return found


def test_known_light_alone_has_no_further_light():
    assert errors(KNOWN, KNOWN).further().mean == pytest.approx(1.0, rel=1e-5)


def test_the_error_is_that_of_the_light_that_is_added():
    assert errors(KNOWN + FURTHER).further().mean == pytest.approx(0.0, abs=1e-5)
    assert errors(KNOWN + 0.9 * FURTHER).further().mean == pytest.approx(0.1, rel=1e-3)


def test_what_changes_from_pixel_to_pixel_does_not_count():
    noise = torch.zeros(16, 16)
    noise[::2], noise[1::2] = 0.1, -0.1
    assert errors(KNOWN + FURTHER + noise).further().mean == pytest.approx(0.0, abs=1e-5)


def test_scenes_with_more_light_count_more_and_the_interval_is_theirs():
    found = errors(KNOWN, KNOWN + FURTHER)
    found.there = [3.0, 1.0]
    found.wrong[AS_IT_IS] = [3.0, 0.0]
    estimate = found.further()
    assert estimate.mean == 0.75 and (estimate.low, estimate.high) == (0.0, 1.0)


@pytest.fixture(scope="module")
def split(tmp_path_factory):
    root = tmp_path_factory.mktemp("light")
    make(root / "data", resolution=16)
    return ShardSplit(root / "data", "test")


def test_rays_are_cast_once(split, tmp_path, monkeypatch):
    first = clean_scene(split, 0, tmp_path)
    assert len(list(tmp_path.iterdir())) == 1
    monkeypatch.setattr("rfpp.inference.gbuffers.first_hit", lambda *args: pytest.fail("cast again"))
    again = clean_scene(split, 0, tmp_path)
    np.testing.assert_allclose(again.views.gbuffer, first.views.gbuffer, rtol=2e-3, atol=1e-4)


def test_networks_rivals_and_known_light_are_measured_alike(split, tmp_path):
    net = network("+experiment=quickstart")
    predictors = {"known": None, "radiosity": UnlearnedRadiosity().eval(), "linear": net}
    found = measure(predictors, split, tmp_path, lambda: torch.autocast("cpu", enabled=False))
    assert found["known"].further().mean == pytest.approx(1.0, rel=1e-5)
    assert set(found["linear"].growth()) == {"exchanged_tokens", "permuted_light", "no_transport"}
    assert found["radiosity"].growth() == {}
    assert found["radiosity"].further().scenes == len(split)


def test_the_table_keeps_the_rows_of_others(tmp_path):
    file = tmp_path / "light.csv"
    row = {"data": "light_test", "method": "a", "log_l1": 0.5}
    write_light_rows([row, row | {"method": "b"}], file)
    write_light_rows([row | {"log_l1": 0.25}], file)
    rows = list(csv.DictReader(file.open(encoding="utf-8")))
    assert [(r["method"], r["log_l1"]) for r in rows] == [("b", "0.5"), ("a", "0.25")]


def test_light_that_is_missing_everywhere_shows_as_energy():
    found = errors(KNOWN + FURTHER, KNOWN + 0.5 * FURTHER)
    assert found.energy() == pytest.approx(0.75, rel=1e-3)
    assert found.median() == pytest.approx(0.25, rel=1e-2)


def row(**values) -> dict[str, str]:
    return dict.fromkeys(COLUMNS, "") | {
        "data": "light_test", "further_light_low": "0.1", "further_light_high": "0.3", "further_light_median": "0.2",
        "further_energy": "1", "log_l1": "0.003",
    } | values  # fmt: skip


def test_seeds_stand_together_and_the_best_first():
    ours = {"method": "ours", "steps": "300", "trained_on": "quickstart", "log_l1_growth_exchanged_tokens": "0.25"}
    rows = [row(method="rival", further_light="0.25")]
    rows += [row(**ours, seed=str(seed), further_light=light) for seed, light in enumerate(("0.1", "0.3"))]
    lines = markdown(rows).splitlines()
    assert lines[0] == "## light_test"
    assert lines[4].startswith("| ours, 300 steps on quickstart | 2 | 0.200 ± 0.141 | 0.100–0.300 |")
    assert "| +25.0% |" in lines[4]
    assert lines[5].startswith("| *rival* |  | 0.250 |")


def test_the_command_writes_table_and_picture(tmp_path):
    file = write_light_rows(
        [row(method="rival", further_light="0.25"), row(method="a", further_light="1")], tmp_path / "light.csv"
    )
    main([str(file)])
    assert (tmp_path / "light.md").read_text(encoding="utf-8").count("|---|") == 1
    assert Image.open(tmp_path / "light.png").size[0] > 600
