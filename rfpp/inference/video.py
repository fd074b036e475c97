"""MP4 files: H.264 as every browser plays it."""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Iterable
from contextlib import suppress
from itertools import chain
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from rfpp.errors import MissingDependencyError, UserError

#: x264's constant rate factor: 18 is taken for visually lossless.
_QUALITY = 18


def encoder() -> str:
    """The path of an ffmpeg program, which is run as a process of its own: it is under the GPL, this project is not.

    Raises:
        MissingDependencyError: there is none.
    """
    try:
        import imageio_ffmpeg

        return imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError) as error:
        reason = str(error).splitlines()[0]
        raise MissingDependencyError(f'a video needs ffmpeg ({reason}): pip install "rfpp[video]"') from None


def write_video(pictures: Iterable[UInt8[np.ndarray, "h w 3"]], path: Path, fps: float | int) -> Path:
    """Write pictures of one size as an MP4 file, atomically, creating its folder; returns `path`.

    H.264 halves the resolution of colour, so that sides must be even: an odd one is extended by a row or column.

    Args:
        pictures: at least one; read one at a time.
        fps: frames per second.

    Raises:
        MissingDependencyError: there is no ffmpeg.
        UserError: the file cannot be written.
    """
    program, pictures = encoder(), iter(pictures)
    first = _even(next(pictures))
    height, width = first.shape[:2]
    colours = ["-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709"]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder:
            made = Path(folder) / "video.mp4"
            command = [
                program, "-v", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}",
                "-r", str(fps), "-i", "-", "-vf", "scale=out_color_matrix=bt709:out_range=tv", *colours,
                "-c:v", "libx264", "-crf", str(_QUALITY), "-pix_fmt", "yuv420p", "-movflags", "+faststart", str(made),
            ]  # fmt: skip
            _feed(command, (picture.tobytes() for picture in chain([first], map(_even, pictures))), path)
            os.replace(made, path)
    except OSError as error:
        raise UserError(f"{path}: cannot be written ({error.strerror}): free space or choose another place") from None
    return path


def _feed(command: list[str], frames: Iterable[bytes], path: Path) -> None:
    """Run a program with frames on its standard input. Raises UserError with its last words where it fails."""
    with tempfile.TemporaryFile() as words:
        streams = {"stdin": subprocess.PIPE, "stdout": subprocess.DEVNULL, "stderr": words}
        # A broken pipe means that the program gave up; it says why.
        with suppress(BrokenPipeError), subprocess.Popen(command, **streams) as process:
            try:
                for frame in frames:
                    process.stdin.write(frame)
            except BrokenPipeError:
                raise
            except BaseException:  # out of `frames`, or Ctrl-C
                process.kill()
                raise
        if process.returncode:
            words.seek(0)
            last = (words.read().decode(errors="replace").strip().splitlines() or ["no reason given"])[-1]
            raise UserError(f"{path}: ffmpeg could not write it ({last}): free space or choose another place")


def _even(picture: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "_ _ 3"]:
    height, width = picture.shape[:2]
    return np.pad(picture, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
