from dataclasses import replace

from marks import requires_blender
from small_data import REFERENCE, BoxFamily

from rfpp.benchmark.reference_quality import measure


@requires_blender
def test_more_samples_have_less_error_and_the_last_row_is_the_noise():
    presets = {"few": replace(REFERENCE, samples=2), "many": replace(REFERENCE, samples=64)}
    turns = []
    rows = list(
        measure({"boxes": BoxFamily()}, presets, replace(REFERENCE, samples=256), 2, 16, 0, lambda *t: turns.append(t))
    )
    assert [row["setting"] for row in rows] == ["few", "many", "converged, other seed"]
    assert turns == [(2, 8), (4, 8), (6, 8), (8, 8)]
    assert all(row["seconds"] > 0 and row["family"] == "boxes" for row in rows)
    assert rows[0]["relative_l1"] > rows[1]["relative_l1"] > rows[2]["relative_l1"] > 0
