"""MP4 files: H.264 in a profile that all browsers play."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable
from contextlib import closing
from itertools import chain
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from rfpp.errors import MissingDependencyError, UserError

#: Options of ffmpeg: visually lossless x264, sRGB primaries, and playback during download.
_OPTIONS = [
    "-crf", "18", "-vf", "scale=out_color_matrix=bt709:out_range=tv", "-colorspace", "bt709",
    "-color_primaries", "bt709", "-color_trc", "bt709", "-movflags", "+faststart",
]  # fmt: skip


def require_encoder() -> None:
    """Raise MissingDependencyError if there is no ffmpeg, a GPL program that runs in a separate process."""
    try:
        import imageio_ffmpeg

        imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError) as error:
        reason = str(error).splitlines()[0]
        raise MissingDependencyError(f'a video needs ffmpeg ({reason}): pip install "rfpp[video]"') from None


def write_video(pictures: Iterable[UInt8[np.ndarray, "h w 3"]], path: Path, fps: float | int) -> Path:
    """Write pictures of one size as an MP4 file, atomically, and return its path.

    H.264 halves the resolution of color, so odd sides are extended by a row or column. Raises UserError if ffmpeg is
    missing or fails; it prints the reason.
    """
    require_encoder()
    from imageio_ffmpeg import count_frames_and_secs, write_frames

    pictures = map(_even, pictures)
    first, count = next(pictures), 0
    options = {"quality": None, "codec": "libx264", "macro_block_size": 1, "ffmpeg_log_level": "error"}
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder:
            video = Path(folder) / "video.mp4"
            with closing(write_frames(video, first.shape[1::-1], fps=fps, output_params=_OPTIONS, **options)) as writer:
                writer.send(None)
                for picture in chain([first], pictures):
                    writer.send(picture.tobytes())
                    count += 1
            if not video.is_file() or count_frames_and_secs(video)[0] != count:
                raise OSError(0, "ffmpeg failed")
            os.replace(video, path)
    except (OSError, RuntimeError) as error:
        reason = getattr(error, "strerror", None) or "ffmpeg failed"
        raise UserError(f"{path}: cannot be written ({reason}): free space or choose another place") from None
    return path


def _even(picture: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "_ _ 3"]:
    height, width = picture.shape[:2]
    return np.pad(picture, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
