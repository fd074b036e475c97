"""MP4 files, read back."""

import subprocess
import sys

import numpy as np
import pytest

from rfpp.errors import MissingDependencyError, UserError
from rfpp.inference.video import encoder, write_video

imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg", reason='no ffmpeg: pip install "rfpp[video]"')


def frames(count: int, height: int = 32, width: int = 48) -> list[np.ndarray]:
    """A wide bar of its own colour that wanders over grey."""
    made = np.full((count, height, width, 3), 128, np.uint8)
    for number, frame in enumerate(made):
        frame[:, 4 * number : 4 * number + 16] = (220, 40, 60)
    return list(made)


def read(path) -> tuple[dict, list[np.ndarray]]:
    reader = imageio_ffmpeg.read_frames(str(path))
    meta = next(reader)
    width, height = meta["size"]
    return meta, [np.frombuffer(frame, np.uint8).reshape(height, width, 3) for frame in reader]


def test_frames_sizes_rate_and_colours_read_back(tmp_path):
    path = write_video(iter(frames(7)), tmp_path / "new" / "film.mp4", fps=12.5)
    meta, shown = read(path)
    assert len(shown) == 7
    assert meta["size"] == (48, 32)
    assert meta["fps"] == pytest.approx(12.5)
    assert meta["codec"] == "h264"
    assert meta["pix_fmt"].startswith("yuv420p")
    for original, frame in zip(frames(7), shown, strict=True):
        difference = np.abs(original.astype(int) - frame)
        assert difference.mean() < 6  # colour has half the resolution: the bar's edges smear
    assert np.abs(shown[0][16, 8].astype(int) - (220, 40, 60)).max() < 8
    assert [file.name for file in path.parent.iterdir()] == ["film.mp4"]


def test_a_browser_can_start_before_all_of_it_has_come(tmp_path):
    content = write_video(frames(3), tmp_path / "film.mp4", fps=24).read_bytes()
    assert 0 < content.index(b"moov") < content.index(b"mdat")


def test_odd_sides_are_extended_and_one_frame_is_a_film(tmp_path):
    meta, shown = read(write_video(frames(1, 31, 47), tmp_path / "film.mp4", fps=24))
    assert meta["size"] == (48, 32)
    assert len(shown) == 1


def test_what_fails_while_frames_are_made_leaves_nothing_and_keeps_the_old_film(tmp_path):
    path = write_video(frames(2), tmp_path / "film.mp4", fps=24)
    before = path.read_bytes()

    def breaking():
        yield from frames(2)
        raise UserError("frame 2: gone")

    with pytest.raises(UserError, match="frame 2: gone"):
        write_video(breaking(), path, fps=24)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_an_encoder_that_fails_is_quoted(tmp_path, monkeypatch):
    program = tmp_path / "ffmpeg"
    program.write_text("#!/bin/sh\necho 'first word' >&2\necho 'No space left on device' >&2\nexit 1\n")
    program.chmod(0o755)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(program))
    with pytest.raises(UserError, match=r"film\.mp4: ffmpeg could not write it \(No space left on device\)"):
        write_video(frames(50, 256, 256), tmp_path / "out" / "film.mp4", fps=24)
    assert list((tmp_path / "out").iterdir()) == []


def test_an_unwritable_place_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match=r"film\.mp4: cannot be written"):
        write_video(frames(2), tmp_path / "file" / "film.mp4", fps=24)


def test_a_missing_encoder_is_named_with_the_remedy(monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(MissingDependencyError, match=r"pip install \"rfpp\[video\]\""):
        encoder()


def test_the_encoder_is_a_program_of_its_own():
    assert subprocess.run([encoder(), "-version"], capture_output=True, check=True).stdout.startswith(b"ffmpeg")
