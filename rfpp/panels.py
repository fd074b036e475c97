"""Pictures for people: radiance as 8-bit sRGB, errors in false colours, labelled sheets of both, and PNG files."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw, ImageFont

from rfpp.radiance import exposed, perceptual, srgb, to_8bit
from rfpp.scene.files import write_atomically

#: Tone-mapped error that the error scale shows as its brightest colour.
ERROR_FULL_SCALE = 0.25

#: Black through purple and orange to pale yellow: five stops of matplotlib's "inferno".
_ERROR_COLOURS = np.array([[0, 0, 4], [87, 16, 110], [188, 55, 84], [249, 142, 9], [252, 255, 164]])

_MIN_TILE = 160  # pixels; smaller images are enlarged by whole factors, so that their pixels stay visible
_GAP, _LINE, _FONT_SIZE = 4, 18, 12
_PAPER, _INK = (255, 255, 255), (40, 40, 40)


def tone_mapped(radiance: Float[np.ndarray, "h w 3"], stops: float = 0.0) -> UInt8[np.ndarray, "h w 3"]:
    """Linear radiance (or albedo) as an 8-bit sRGB picture after `stops` of exposure."""
    return to_8bit(srgb(exposed(_tensor(radiance), stops))).numpy()


def error_map(
    prediction: Float[np.ndarray, "h w 3"], reference: Float[np.ndarray, "h w 3"]
) -> UInt8[np.ndarray, "h w 3"]:
    """Mean error over the channels of clamp(log2(1 + I), 0, 1): black is none, pale yellow 0.25 and more, or NaN."""
    error = (perceptual(_tensor(prediction)) - perceptual(_tensor(reference))).abs().mean(dim=-1).numpy()
    share = np.nan_to_num(error / ERROR_FULL_SCALE, nan=1.0) * (len(_ERROR_COLOURS) - 1)
    stops = np.arange(len(_ERROR_COLOURS))
    channels = [np.interp(share, stops, _ERROR_COLOURS[:, channel]) for channel in range(3)]
    return np.stack(channels, axis=-1).round().astype(np.uint8)


def panel(columns: Mapping[str, Sequence[np.ndarray]], captions: Sequence[str] = ()) -> UInt8[np.ndarray, "h w 3"]:
    """A sheet of pictures of one size: a heading over each column and, where given, a caption under each row.

    Args:
        columns: heading → 8-bit pictures [h, w, 3], from top to bottom.
        captions: a line of text per row, or none at all.
    """
    rows = list(zip(*columns.values(), strict=True))
    height, width = rows[0][0].shape[:2]
    factor = max(1, -(-_MIN_TILE // max(height, width)))
    height, width = height * factor, width * factor
    row_height = height + _GAP + (_LINE if captions else 0)
    sheet = Image.new("RGB", (len(columns) * (width + _GAP) + _GAP, _LINE + len(rows) * row_height), _PAPER)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(_FONT_SIZE)
    lefts = [_GAP + index * (width + _GAP) for index in range(len(columns))]
    for left, heading in zip(lefts, columns, strict=True):
        draw.text((left + width / 2, _LINE / 2), heading, _INK, font, anchor="mm")
    for index, pictures in enumerate(rows):
        top = _LINE + index * row_height
        for left, picture in zip(lefts, pictures, strict=True):
            sheet.paste(Image.fromarray(picture).resize((width, height), Image.Resampling.NEAREST), (left, top))
        if captions:
            draw.text((_GAP, top + height + 2), captions[index], _INK, font)
    return np.asarray(sheet)


def save_png(picture: UInt8[np.ndarray, "h w 3"], path: Path | str) -> Path:
    """Write a PNG file atomically, creating its folder; returns the path. Raises UserError (full disk)."""
    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, format="png")
    return write_atomically(Path(path), stream.getvalue())


def _tensor(image: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(image, dtype=np.float32))
