"""Errors of further light: what counts, what does not, and the command that measures them."""

import csv
from dataclasses import replace

import numpy as np
import pytest
import torch
from known_scenes import LIGHT, look_at, material, pack, sphere, square
from networks import network
from PIL import Image
from small_data import make

from rfpp.evaluation.measuring.clean_views import clean_scene, known_finely, without_glints
from rfpp.evaluation.measuring.light import AS_IT_IS, LightErrors, measure
from rfpp.evaluation.tables.light_summary import main, markdown
from rfpp.evaluation.tables.light_table import COLUMNS, write_light_rows
from rfpp.model.radiosity import UnlearnedRadiosity
from rfpp.scene.packed import PackedScene
from rfpp.shards.dataset import ShardSplit

FURTHER = torch.rand(2, 3, 16, 16, generator=torch.Generator().manual_seed(1))


def errors(*added: torch.Tensor) -> LightErrors:
    found = LightErrors()
    for further in added:
        found.add(AS_IT_IS, further, FURTHER, 0.0)
    return found


def test_known_light_alone_has_no_further_light():
    assert errors(0 * FURTHER, 0 * FURTHER).further().mean == pytest.approx(1.0, rel=1e-5)


def test_the_error_is_that_of_the_light_that_is_added():
    assert errors(FURTHER).further().mean == pytest.approx(0.0, abs=1e-5)
    assert errors(0.9 * FURTHER).further().mean == pytest.approx(0.1, rel=1e-3)


def test_what_changes_from_pixel_to_pixel_does_not_count():
    noise = torch.zeros(16, 16)
    noise[::2], noise[1::2] = 0.1, -0.1
    assert errors(FURTHER + noise).further().mean == pytest.approx(0.0, abs=1e-5)


def test_pixels_in_which_a_lamp_glints_do_not_count():
    mirror = pack(
        (square(2.0), material(0.3)),
        (sphere(0.3, (0, 0, 0.3)), material(0.0, specular=0.9, roughness=0.2)),
        (LIGHT + np.array([0.5, -1.0, 2.0]), material(emission=30_000.0)),
    )
    scene = PackedScene("mirror", mirror, look_at((0, -2, 1))[None].astype(np.float32), np.float32([40]))
    _, glossy = (torch.from_numpy(lobe) for lobe in known_finely(scene, 32, 32))
    counted = without_glints(glossy, torch.full_like(glossy, 0.2))
    brightest = np.unravel_index(glossy.mean(1).argmax(), (32, 32))
    assert not counted[0, 0][brightest] and 0.9 < counted.mean() < 1


def test_scenes_with_more_light_count_more_and_the_interval_is_theirs():
    found = errors(0 * FURTHER, FURTHER)
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


def test_what_coarse_gbuffers_miss_of_known_light_does_not_count(split, tmp_path):
    """An image that is right but for a lamp in a mirror that its G-buffer missed adds what is to be added."""
    scene = clean_scene(split, 0, tmp_path)
    missed = torch.zeros_like(scene.known)
    missed[..., 3, 5] = 100.0
    right = replace(scene, known=scene.known_finely - missed)
    torch.testing.assert_close(right.added_by(scene.reference - missed), scene.to_add)


def test_networks_rivals_and_known_light_are_measured_alike(split, tmp_path):
    net = network("experiment=quickstart")
    predictors = {"known": None, "radiosity": UnlearnedRadiosity().eval(), "linear": net}
    found = measure(predictors, split, tmp_path, lambda: torch.autocast("cpu", enabled=False))
    assert found["known"].further().mean == pytest.approx(1.0, rel=1e-5)
    assert set(found["linear"].growth()) == {
        "exchanged_tokens", "exchanged_scene", "permuted_light", "no_transport",
    }  # fmt: skip
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
    found = errors(FURTHER, 0.5 * FURTHER)
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
