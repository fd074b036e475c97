"""The benchmark of G-buffers: a row for every value, and errors that fall with samples."""

from hydra import compose, initialize_config_dir
from hydra.utils import instantiate

from rfpp.commands import CONFIG_DIR


def test_a_row_for_every_value_and_less_error_with_more_samples():
    overrides = [
        "benchmark=known_light", "benchmark.case={resolution: 16, triangles: 800, lights: 1, samples: 2}",
        "benchmark.sweeps={samples: [1, 64], resolution: [8], triangles: [], lights: [2]}", "benchmark.scenes=2",
        "benchmark.converged=256",
    ]  # fmt: skip
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        measure = instantiate(compose("benchmark", overrides=overrides).benchmark, _convert_="all")
    told = []
    rows = list(measure(progress=lambda *count: told.append(count)))
    assert [(row["sweep"], row["resolution"], row["lights"], row["samples"]) for row in rows] == [
        ("samples", 16, 1, 1), ("samples", 16, 1, 64), ("resolution", 8, 1, 2), ("lights", 16, 2, 2),
    ]  # fmt: skip
    assert told[-1] == (8, 8)
    few, many, *others = rows
    for light in ("direct_diffuse", "direct_glossy", "reflected_light"):
        assert 0 < many[f"{light}_error"] < few[f"{light}_error"]
        assert all(row[f"{light}_error"] is None for row in others)
    assert all(row[f"{part}_s"] > 0 for row in rows for part in ("structures", "first_hit", "light"))
