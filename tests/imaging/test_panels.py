import numpy as np
from PIL import Image

from rfpp.imaging.panels import (
    contact_sheet,
    distinct_colors,
    error_map,
    false_colors,
    panel,
    save_picture,
    signed_error_map,
)


def test_errors_are_brighter_and_nan_is_brightest() -> None:
    reference = np.zeros((1, 4, 3), np.float32)
    prediction = reference.copy()
    prediction[0, 1:] = [[0.1] * 3, [1.0] * 3, [np.nan] * 3]
    brightness = error_map(prediction, reference).sum(axis=-1)[0]
    assert brightness[0] < 10 < brightness[1] < brightness[2] == brightness[3]
    scale = false_colors(np.linspace(0, 1, 50, dtype=np.float32)[None])[0].astype(int).sum(axis=-1)
    assert (np.diff(scale) > 0).all()
    signed = signed_error_map(prediction, reference)[0].tolist()
    assert signed[0] == [247] * 3 and signed[2] == [178, 24, 43] and signed[3] == [0] * 3


def noise(count: int, size: int) -> list[np.ndarray]:
    return list(np.random.default_rng(size).integers(0, 256, (count, size, size, 3), dtype=np.uint8))


def corner_of(picture: np.ndarray, sheet: np.ndarray, factor: int) -> tuple[int, int]:
    """Return the corner of the enlarged picture on the sheet."""
    enlarged = picture[:, :, 0].repeat(factor, axis=0).repeat(factor, axis=1)
    windows = np.lib.stride_tricks.sliding_window_view(sheet[:, :, 0], enlarged.shape)
    likely = np.argwhere((windows[..., 0, 0] == enlarged[0, 0]) & (windows[..., 50, 50] == enlarged[50, 50]))
    return next((y, x) for y, x in likely.tolist() if np.array_equal(windows[y, x], enlarged))


def test_a_sheet_holds_every_picture_enlarged_by_whole_factors() -> None:
    pictures = noise(6, 64)
    columns = {"a": pictures[:2], "b": pictures[2:4], "c": pictures[4:]}
    sheet = panel(columns, captions=["first", "second"])
    assert all(corner_of(picture, sheet, 3) for picture in pictures)
    titled = panel(columns, captions=["first", "second"], title="title")
    assert len(titled) > len(sheet)
    assert corner_of(pictures[0], titled, 3)[0] > corner_of(pictures[0], sheet, 3)[0]


def test_a_contact_sheet_is_about_square_and_in_order() -> None:
    pictures = noise(7, 160)
    sheet = contact_sheet(pictures, [f"picture {i}" for i in range(7)])
    corners = [corner_of(picture, sheet, 1) for picture in pictures]
    assert corners == sorted(corners)
    assert [len({corner[axis] for corner in corners}) for axis in (0, 1)] == [3, 3]


def test_colors_of_objects_are_distinct_and_negative_numbers_are_black() -> None:
    colors = distinct_colors(np.arange(-1, 100)[None])[0].astype(int)
    assert colors[0].tolist() == [0, 0, 0]
    assert len(np.unique(colors[1:], axis=0)) == 100
    assert np.abs(np.diff(colors[1:], axis=0)).max(axis=1).min() > 50


def test_pictures_are_png_or_jpeg(tmp_path) -> None:
    picture = np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)
    assert np.array_equal(np.asarray(Image.open(save_picture(picture, tmp_path / "a" / "b.png"))), picture)
    assert Image.open(save_picture(picture, tmp_path / "a.jpg")).format == "JPEG"
