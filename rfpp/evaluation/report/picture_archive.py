"""pictures.zip: the pictures shown in an evaluation's report."""

from __future__ import annotations

import io
import zipfile
import zlib
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError

from rfpp.errors import UserError
from rfpp.files import write_atomically
from rfpp.imaging.panels import Picture

PICTURES_FILE = "pictures.zip"

#: Pixels along the longer side; larger pictures are shrunk, so that the size of a report is bounded.
MAX_PIXELS = 256

_REMEDY = "make it again with launch/evaluate.py"


@dataclass(frozen=True)
class StoredPicture:
    """A picture as WebP.

    Attributes:
        content: the bytes of the file.
        width, height: in pixels.
    """

    content: bytes
    width: int
    height: int

    @classmethod
    def of(cls, picture: Picture) -> StoredPicture:
        """Encode losslessly; images larger than `MAX_PIXELS` are downscaled."""
        image, stream = Image.fromarray(np.ascontiguousarray(picture)), io.BytesIO()
        image.thumbnail((MAX_PIXELS, MAX_PIXELS), Image.Resampling.BOX)
        image.save(stream, format="webp", lossless=True)
        return cls(stream.getvalue(), *image.size)

    @classmethod
    def read(cls, content: bytes) -> StoredPicture:
        """Raises ValueError: it is no WebP."""
        try:
            with Image.open(io.BytesIO(content), formats=["webp"]) as image:
                return cls(content, *image.size)
        except (UnidentifiedImageError, Image.DecompressionBombError, OSError) as error:
            raise ValueError(f"a picture is damaged: {error}") from None


#: By what they show, of the scenes by (split, key).
StoredPictures = Mapping[tuple[str, str], Mapping[str, StoredPicture]]


def write_pictures(pictures: Mapping[tuple[str, str], Mapping[str, Picture]], folder: Path) -> Path:
    """Write pictures.zip, of `<split>/<key>/<name>.webp`, into `folder`; returns its path.

    Args:
        pictures: by what they show, "reference" and "prediction" among them, of the scenes by (split, key).

    Raises:
        UserError: it cannot be written.
    """
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for (split, key), of_scene in pictures.items():
            for name, picture in of_scene.items():
                member = zipfile.ZipInfo(f"{split}/{key}/{name}.webp")  # dated 1980: equal pictures are equal bytes
                archive.writestr(member, StoredPicture.of(picture).content)
    return write_atomically(folder / PICTURES_FILE, stream.getvalue())


def read_pictures(folder: Path) -> StoredPictures:
    """The inverse of `write_pictures`. Raises UserError naming the file: absent, damaged, or not of pictures."""
    path = folder / PICTURES_FILE
    pictures: dict[tuple[str, str], dict[str, StoredPicture]] = defaultdict(dict)
    try:
        with zipfile.ZipFile(path) as archive:
            for member in archive.namelist():
                split, _, of_split = member.partition("/")
                key, _, name = of_split.rpartition("/")
                pictures[split, key][name.removesuffix(".webp")] = StoredPicture.read(archive.read(member))
    except (ValueError, zipfile.BadZipFile, zlib.error, EOFError, RuntimeError) as error:  # RuntimeError: encrypted
        raise UserError(f"{path}: cannot be read ({error}): {_REMEDY}") from None
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}): {_REMEDY}") from None
    for (split, key), of_scene in pictures.items():
        if not {"reference", "prediction"} <= of_scene.keys():
            raise UserError(f"{path}: lacks a picture of {split}/{key}: {_REMEDY}")
    return dict(pictures)
