"""Pictures for inspection: 8-bit sRGB, false colors, labeled sheets, and their files."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from PIL import Image, ImageDraw, ImageFont

from rfpp.files import write_atomically
from rfpp.imaging.radiance import exposed, perceptual, srgb, to_8bit

Picture = UInt8[np.ndarray, "_ _ 3"]
Radiance = Float[np.ndarray, "h w 3"]

#: Error that the error scale shows in its brightest color.
ERROR_FULL_SCALE = 0.25
#: Black through purple and orange to pale yellow: five stops of matplotlib's "inferno".
_SCALE = np.array([[0, 0, 4], [87, 16, 110], [188, 55, 84], [249, 142, 9], [252, 255, 164]])
#: Blue through white to red: ends and middle of ColorBrewer's "RdBu".
_DIVERGING = np.array([[33, 102, 172], [247, 247, 247], [178, 24, 43]])
#: Pixels of the smallest tile; smaller images are enlarged by whole factors.
_MIN_TILE = 160
_GAP, _LINE, _FONT_SIZE = 4, 18, 12
_PAPER, _INK = (255, 255, 255), (40, 40, 40)
_JPEG_QUALITY = 90


def tone_mapped(radiance: Radiance, stops: float = 0.0) -> UInt8[np.ndarray, "h w 3"]:
    """Return linear radiance (or albedo) as an 8-bit sRGB picture after `stops` of exposure."""
    return to_8bit(srgb(exposed(_tensor(radiance), stops))).numpy()


def error_map(prediction: Radiance, reference: Radiance) -> UInt8[np.ndarray, "h w 3"]:
    """Return the mean error of clamp(log2(1 + I), 0, 1): black is 0, pale yellow 0.25 and more, or NaN."""
    error = (perceptual(_tensor(prediction)) - perceptual(_tensor(reference))).abs().mean(dim=-1).numpy()
    return false_colors(np.nan_to_num(error / ERROR_FULL_SCALE, nan=1.0))


def signed_error_map(prediction: Radiance, reference: Radiance) -> UInt8[np.ndarray, "h w 3"]:
    """Return the signed mean error: blue is too dark, white 0, red too bright, both full at 0.25; NaN is black."""
    error = (perceptual(_tensor(prediction)) - perceptual(_tensor(reference))).mean(dim=-1).numpy()
    return _interpolated(error / ERROR_FULL_SCALE, -1.0, _DIVERGING)


def false_colors(share: Float[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w 3"]:
    """Return numbers in [0, 1] as colors from black to pale yellow."""
    return _interpolated(share, 0.0, _SCALE)


def distinct_colors(ids: Int[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w 3"]:
    """Return a color for each number, unlike those of its neighbors; black for negative numbers."""
    hue = (ids * 0.6180339887498949)[..., None] * 6 + np.array([0, 4, 2])  # steps of the golden ratio never repeat
    pure = np.clip(np.abs(hue % 6 - 3) - 1, 0, 1)
    paleness = 0.25 + 0.4 * (ids * 0.7548776662466927 % 1)[..., None]
    return np.where(ids[..., None] >= 0, 255 * (paleness + (1 - paleness) * pure), 0).astype(np.uint8)


def panel(
    columns: Mapping[str, Sequence[Picture]], captions: Sequence[str] = (), title: str = ""
) -> UInt8[np.ndarray, "h w 3"]:
    """Return a sheet of pictures with headings, captions and a title.

    Args:
        columns: Heading → 8-bit pictures from top to bottom, of one shape but possibly several resolutions.
        captions: A line of text under each row, or nothing.
        title: Title of the sheet, or nothing.
    """
    rows = list(zip(*columns.values(), strict=True))
    return _sheet(rows, list(columns), [[caption, *[""] * (len(columns) - 1)] for caption in captions], title)


def contact_sheet(pictures: Sequence[Picture], captions: Sequence[str]) -> UInt8[np.ndarray, "h w 3"]:
    """Return pictures of one shape with captions, in about as many rows as columns."""
    wide = math.ceil(math.sqrt(len(pictures)))
    starts = range(0, len(pictures), wide)
    return _sheet([pictures[i : i + wide] for i in starts], [], [captions[i : i + wide] for i in starts])


def save_picture(picture: Picture, path: Path | str) -> Path:
    """Write a PNG file, or JPEG if its name ends in .jpg, atomically. Raises UserError if it cannot be written."""
    path, stream = Path(path), io.BytesIO()
    Image.fromarray(picture).save(stream, "jpeg" if path.suffix == ".jpg" else "png", quality=_JPEG_QUALITY)
    return write_atomically(path, stream.getvalue())


def _sheet(
    rows: Sequence[Sequence[Picture]], headings: Sequence[str], captions: Sequence[Sequence[str]], title: str = ""
) -> UInt8[np.ndarray, "h w 3"]:
    """Return pictures side by side, enlarged to the size of the largest, with lines of text."""
    height, width = max(picture.shape[:2] for row in rows for picture in row)
    factor = max(1, -(-_MIN_TILE // max(height, width)))
    height, width = height * factor, width * factor
    top = _LINE * bool(title) + (_LINE if headings else _GAP)
    row_height = height + _GAP + _LINE * bool(captions)
    sheet = Image.new("RGB", (max(map(len, rows)) * (width + _GAP) + _GAP, top + len(rows) * row_height), _PAPER)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(_FONT_SIZE)
    draw.text((_GAP, 2), title, _INK, font)
    for column, heading in enumerate(headings):
        draw.text((_GAP + column * (width + _GAP) + width / 2, top - _LINE / 2), heading, _INK, font, anchor="mm")
    for row, pictures in enumerate(rows):
        for column, picture in enumerate(pictures):
            corner = _GAP + column * (width + _GAP), top + row * row_height
            sheet.paste(Image.fromarray(picture).resize((width, height), Image.Resampling.NEAREST), corner)
            if captions:
                draw.text((corner[0], corner[1] + height + 2), captions[row][column], _INK, font)
    return np.asarray(sheet)


def _interpolated(
    values: Float[np.ndarray, "h w"], low: float, colors: Int[np.ndarray, "n 3"]
) -> UInt8[np.ndarray, "h w 3"]:
    """Return values from `low` to 1 as colors between equidistant stops; NaN becomes black."""
    channels = [np.interp(values, np.linspace(low, 1, len(colors)), colors[:, channel]) for channel in range(3)]
    return np.nan_to_num(np.stack(channels, axis=-1)).round().astype(np.uint8)


def _tensor(image: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(image, dtype=np.float32))
