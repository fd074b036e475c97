"""MP4 files: H.264 in a profile that all browsers play."""

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

#: x264's constant rate factor: 18 is visually lossless.
_QUALITY = "18"
_OPTIONS = (
    "-vf scale=out_color_matrix=bt709:out_range=tv -colorspace bt709 -color_primaries bt709 -color_trc bt709 "
    f"-c:v libx264 -crf {_QUALITY} -pix_fmt yuv420p -movflags +faststart"
).split()


def encoder() -> str:
    """Return the path of ffmpeg, a GPL program that runs in a separate process.

    Raises:
        MissingDependencyError: If it is missing.
    """
    try:
        import imageio_ffmpeg

        return imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError) as error:
        reason = str(error).splitlines()[0]
        raise MissingDependencyError(f'a video needs ffmpeg ({reason}): pip install "rfpp[video]"') from None


def write_video(pictures: Iterable[UInt8[np.ndarray, "h w 3"]], path: Path, fps: float | int) -> Path:
    """Write pictures of one size as an MP4 file, atomically, and return its path.

    H.264 halves the resolution of color, so odd sides are extended by a row or column.

    Args:
        pictures: At least one picture.
        path: Path of the file; its folder is created.
        fps: Frames per second.

    Raises:
        MissingDependencyError: If ffmpeg is missing.
        UserError: If the file cannot be written.
    """
    pictures = map(_even, pictures)
    first = next(pictures)
    raw = f"-v error -f rawvideo -pix_fmt rgb24 -s {first.shape[1]}x{first.shape[0]} -r {fps} -i -".split()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder:
            video = Path(folder) / "video.mp4"
            _run([encoder(), *raw, *_OPTIONS, str(video)], (p.tobytes() for p in chain([first], pictures)), path)
            os.replace(video, path)
    except OSError as error:
        raise UserError(f"{path}: cannot be written ({error.strerror}): free space or choose another place") from None
    return path


def _run(command: list[str], frames: Iterable[bytes], path: Path) -> None:
    """Run a program with frames on its standard input. Raises UserError with its last message if it fails."""
    with tempfile.TemporaryFile() as log:
        streams = {"stdin": subprocess.PIPE, "stdout": subprocess.DEVNULL, "stderr": log}
        with suppress(BrokenPipeError), subprocess.Popen(command, **streams) as process:  # its exit status says more
            try:
                process.stdin.writelines(frames)
            except BrokenPipeError:
                raise
            except BaseException:  # raised by `frames`, or Ctrl-C
                process.kill()
                raise
        if process.returncode:
            log.seek(0)
            last = (log.read().decode(errors="replace").strip().splitlines() or ["no message"])[-1]
            raise UserError(f"{path}: ffmpeg could not write it ({last}): free space or choose another place")


def _even(picture: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "_ _ 3"]:
    height, width = picture.shape[:2]
    return np.pad(picture, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
