"""A network beside Cycles with few samples: rows, references that are kept, and the plot."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from edited_scenes import scene
from marks import requires_blender
from networks import checkpoint_info, network
from PIL import Image
from small_data import REFERENCE

from rfpp.benchmark.equal_time import FilmSettings, dimmed, measure, orbit
from rfpp.benchmark.equal_time_plot import main, plot, times_at_equal_error
from rfpp.benchmark.exhibits import SceneFile
from rfpp.errors import UserError
from rfpp.inference.renderer import Renderer
from rfpp.scene.io.saving import save_scene
from rfpp.scene.packed import pack
from rfpp.scene.triangles import EMISSION


def test_an_orbit_turns_the_camera_about_the_vertical_axis():
    still = pack(scene()).views([0])
    turned = orbit(still, [0.0, 90.0])
    np.testing.assert_allclose(turned.c2w[0], still.c2w[0], atol=1e-6)
    x, y, z = still.c2w[0][:3, 3]
    np.testing.assert_allclose(turned.c2w[1][:3, 3], (-y, x, z), atol=1e-6)
    assert turned.triangles is still.triangles


def test_one_light_is_dimmed_and_nothing_else():
    before = pack(scene())
    after = dimmed(before)
    halved = (after.triangles.material != before.triangles.material).any(1)
    assert set(before.triangles.object_index[halved]) == {
        before.triangles.object_index[before.triangles.is_emissive][0]
    }
    np.testing.assert_array_equal(
        after.triangles.material[halved, EMISSION] * 2, before.triangles.material[halved, EMISSION]
    )


@requires_blender
def test_a_row_for_each_scene_and_method_and_references_are_rendered_once(tmp_path, monkeypatch):
    Renderer(network(), checkpoint_info()).save(tmp_path / "net")
    path = save_scene(scene(), tmp_path / "six.json")
    turns = []

    def rows():
        return list(
            measure(
                str(tmp_path / "net"),
                [SceneFile("six", path)],
                16,
                [{"light_samples": 16, "supersampling": 1, "token_resolution": 128}],
                [1, 8],
                1,
                REFERENCE,
                replace(REFERENCE, samples=64, seed=1),
                FilmSettings(frames=3, resolution=16, samples=2),
                tmp_path / "kept",
                lambda *turn: turns.append(turn),
            )
        )

    measured = rows()
    rows_of = [(row["method"], row["samples"]) for row in measured]
    assert rows_of == [("rfpp 16 of 1", 0), ("Cycles 1", 1), ("Cycles 8", 8)]
    assert turns == [(n, 6) for n in range(1, 7)]
    assert all(row[name] > 0 for row in measured for name in ("first_s", "view_s", "edit_s", "frame_s"))
    assert measured[2]["log_l1"] < measured[1]["log_l1"]  # more samples, less noise
    assert measured[2]["ssim"] > measured[1]["ssim"]
    kept = sorted((tmp_path / "kept").iterdir())
    assert len(kept) == 2
    before = [file.stat().st_mtime_ns for file in kept]
    again = rows()
    assert [file.stat().st_mtime_ns for file in kept] == before
    assert again[1]["log_l1"] == measured[1]["log_l1"]

    def width_of_plot(columns):
        with (tmp_path / "equal_time.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, columns, extrasaction="ignore")
            writer.writeheader()
            writer.writerows(measured)
        return Image.open(plot(tmp_path / "equal_time.csv")).size[0]

    without_film = [name for name in measured[0] if name not in ("frame_s", "flicker")]
    assert width_of_plot(list(measured[0])) > 1.2 * width_of_plot(without_film)  # a panel less


def test_another_table_is_refused_in_a_line(tmp_path, capsys):
    file = tmp_path / "gallery.csv"
    file.write_text("scene,flip\na,1\n")
    with pytest.raises(UserError, match="not a table of benchmark=equal_time"):
        plot(file)
    with pytest.raises(SystemExit):
        main([str(file)])
    assert capsys.readouterr().err.startswith(f"error: {file}: not a table")


def test_time_at_equal_error_lies_between_numbers_of_samples():
    def row(method, samples, seconds, error):
        return {"scene": "a", "method": method, "samples": str(samples), "view_s": str(seconds), "flip": str(error)}

    cycles = [row("Cycles 1", 1, 1.0, 0.4), row("Cycles 4", 4, 4.0, 0.2), row("Cycles 16", 16, 16.0, 0.1)]
    for seconds, error, expected in [
        (1.0, 0.2, 1 / 4),
        (1.0, 0.4 * 2**-0.5, 1 / 2),  # half of the way, in logarithms
        (8.0, 0.05, 1 / 2),  # better than the most samples
        (2.0, 0.8, 2.0),  # worse than the fewest
    ]:
        rows = [*cycles, row("rfpp", 0, seconds, error), row("other", 0, 9.0, 0.3)]
        assert times_at_equal_error(rows, "rfpp", "view_s", "flip") == pytest.approx([expected])
