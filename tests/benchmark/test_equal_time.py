"""A renderer beside Cycles with few samples: rows, cached references, and the plot."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from edited_scenes import scene
from marks import requires_blender
from networks import checkpoint_info, network
from PIL import Image
from small_data import REFERENCE

from rfpp.benchmark.equal_time import measure, orbit
from rfpp.benchmark.equal_time_plot import main, plot, times_at_equal_error
from rfpp.inference.renderer import Renderer
from rfpp.scene.packed import pack


def test_an_orbit_rotates_the_camera_about_the_vertical_axis():
    still = pack(scene()).views([0])
    rotated = orbit(still, [0.0, 90.0])
    np.testing.assert_allclose(rotated.c2w[0], still.c2w[0], atol=1e-6)
    x, y, z = still.c2w[0][:3, 3]
    np.testing.assert_allclose(rotated.c2w[1][:3, 3], (-y, x, z), atol=1e-6)
    assert rotated.triangles is still.triangles


@requires_blender
def test_a_row_for_each_scene_and_method_and_references_are_rendered_once(tmp_path):
    Renderer(network(), checkpoint_info()).save(tmp_path / "net")
    turns = []

    def rows():
        return list(
            measure(
                checkpoint=str(tmp_path / "net"),
                exhibits={"six": pack(scene()).views([0])},
                resolution=16,
                samplings=[{"light_samples": 16, "supersampling": 1}],
                samples=[1, 8],
                rounds=1,
                cycles=REFERENCE,
                converged=replace(REFERENCE, samples=64, seed=1),
                animation={"frames": 3, "resolution": 16, "samples": 2},
                cache=str(tmp_path / "cache"),
                progress=lambda *turn: turns.append(turn),
            )
        )

    measured = rows()
    methods = [(row["method"], row["samples"]) for row in measured]
    assert methods == [("net 16 of 1", None), ("Cycles 1", 1), ("Cycles 8", 8)]
    assert turns == [(n, 6) for n in range(1, 7)]
    assert all(row[name] > 0 for row in measured for name in ("first_s", "view_s", "edit_s", "frame_s"))
    assert measured[2]["log_l1"] < measured[1]["log_l1"]  # more samples, less noise
    assert measured[2]["ssim"] > measured[1]["ssim"]
    cached = sorted((tmp_path / "cache").iterdir())
    assert len(cached) == 2
    before = [file.stat().st_mtime_ns for file in cached]
    again = rows()
    assert [file.stat().st_mtime_ns for file in cached] == before
    assert again[1]["log_l1"] == measured[1]["log_l1"]

    def plot_width(columns):
        with (tmp_path / "equal_time.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, columns, extrasaction="ignore")
            writer.writeheader()
            writer.writerows(measured)
        return Image.open(plot(tmp_path / "equal_time.csv")).size[0]

    without_animation = [name for name in measured[0] if name not in ("frame_s", "flicker")]
    assert plot_width(list(measured[0])) > 1.2 * plot_width(without_animation)  # a panel less


def test_another_table_is_reported_in_a_line(tmp_path, capsys):
    file = tmp_path / "gallery.csv"
    file.write_text("scene,flip\na,1\n")
    with pytest.raises(SystemExit):
        main([str(file)])
    assert capsys.readouterr().err.startswith(f"error: {file}: not a table of benchmark=equal_time")


def test_time_at_equal_error_interpolates_between_sample_counts():
    def row(method, samples, seconds, error):
        return {"scene": "a", "method": method, "samples": samples, "view_s": str(seconds), "flip": str(error)}

    cycles = [row("Cycles 1", "1", 1.0, 0.4), row("Cycles 4", "4", 4.0, 0.2), row("Cycles 16", "16", 16.0, 0.1)]
    for seconds, error, expected in [
        (1.0, 0.2, 1 / 4),
        (1.0, 0.4 * 2**-0.5, 1 / 2),  # halfway in logarithms
        (8.0, 0.05, 1 / 2),  # better than the most samples
        (2.0, 0.8, 2.0),  # worse than the fewest
    ]:
        rows = [*cycles, row("radiosity", "", seconds, error), row("other", "", 9.0, 0.3)]
        assert times_at_equal_error(rows, "radiosity", "view_s", "flip") == pytest.approx([expected])
