import numpy as np
import pytest
from PIL import Image

from rfpp.errors import UserError
from rfpp.panels import error_map, panel, save_png, tone_mapped


def test_tone_mapping_shows_mid_grey_and_clips_to_white() -> None:
    radiance = np.array([[[0.0, 0.18, 5.0]]], np.float32)
    assert tone_mapped(radiance).tolist() == [[[0, 118, 255]]]
    assert tone_mapped(radiance, stops=-1.0)[0, 0, 1] < 118


def test_no_error_is_black_and_large_or_undefined_errors_are_brightest() -> None:
    reference = np.zeros((1, 4, 3), np.float32)
    prediction = reference.copy()
    prediction[0, 1:] = [[0.1] * 3, [1.0] * 3, [np.nan] * 3]
    brightness = error_map(prediction, reference).sum(axis=-1)[0]
    assert brightness[0] < 10 < brightness[1] < brightness[2] == brightness[3]


def test_a_sheet_holds_every_picture_enlarged_but_unchanged() -> None:
    rng = np.random.default_rng(0)
    pictures = [[rng.integers(0, 256, (64, 64, 3), dtype=np.uint8) for _ in range(2)] for _ in range(3)]
    sheet = panel(dict(zip("abc", pictures, strict=True)), captions=["first", "second"])
    windows = np.lib.stride_tricks.sliding_window_view(sheet[:, :, 0], (192, 192))
    for picture in (p for column in pictures for p in column):
        enlarged = picture[:, :, 0].repeat(3, axis=0).repeat(3, axis=1)
        corner = np.argwhere((windows[..., 0, 0] == enlarged[0, 0]) & (windows[..., 50, 50] == enlarged[50, 50]))
        assert any(np.array_equal(windows[y, x], enlarged) for y, x in corner)


def test_columns_of_different_length_are_refused() -> None:
    picture = np.zeros((8, 8, 3), np.uint8)
    with pytest.raises(ValueError, match="shorter"):
        panel({"a": [picture, picture], "b": [picture]})


def test_png_round_trip_makes_its_folder(tmp_path) -> None:
    picture = np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)
    path = save_png(picture, tmp_path / "a" / "b.png")
    assert np.array_equal(np.asarray(Image.open(path)), picture)
    assert [f.name for f in path.parent.iterdir()] == ["b.png"]


def test_an_unwritable_place_is_named(tmp_path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match=r"picture\.png"):
        save_png(np.zeros((2, 2, 3), np.uint8), tmp_path / "file" / "picture.png")
