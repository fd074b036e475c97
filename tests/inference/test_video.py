import sys

import numpy as np
import pytest

from rfpp.errors import MissingDependencyError, UserError
from rfpp.inference.video import require_encoder, write_video

imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg", reason='no ffmpeg: pip install "rfpp[video]"')


def frames(count: int, height: int = 32, width: int = 48) -> list[np.ndarray]:
    """A wide bar that moves over gray."""
    made = np.full((count, height, width, 3), 128, np.uint8)
    for number, frame in enumerate(made):
        frame[:, 4 * number : 4 * number + 16] = (220, 40, 60)
    return list(made)


def read(path) -> tuple[dict, list[np.ndarray]]:
    reader = imageio_ffmpeg.read_frames(str(path))
    meta = next(reader)
    width, height = meta["size"]
    return meta, [np.frombuffer(frame, np.uint8).reshape(height, width, 3) for frame in reader]


def test_frames_size_rate_and_colors_round_trip(tmp_path):
    path = write_video(iter(frames(7)), tmp_path / "new" / "film.mp4", fps=12.5)
    meta, decoded = read(path)
    assert len(decoded) == 7
    assert meta["size"] == (48, 32)
    assert meta["fps"] == pytest.approx(12.5)
    assert meta["codec"] == "h264"
    assert meta["pix_fmt"].startswith("yuv420p")
    for original, frame in zip(frames(7), decoded, strict=True):
        difference = np.abs(original.astype(int) - frame)
        assert difference.mean() < 6  # color has half the resolution
    assert np.abs(decoded[0][16, 8].astype(int) - (220, 40, 60)).max() < 8
    assert [file.name for file in path.parent.iterdir()] == ["film.mp4"]


def test_playback_can_start_before_the_download_ends(tmp_path):
    content = write_video(frames(3), tmp_path / "film.mp4", fps=24).read_bytes()
    assert 0 < content.index(b"moov") < content.index(b"mdat")


def test_an_error_in_frames_keeps_the_old_file(tmp_path):
    path = write_video(frames(2), tmp_path / "film.mp4", fps=24)
    before = path.read_bytes()

    def breaking():
        yield from frames(2)
        raise UserError("frame 2: gone")

    with pytest.raises(UserError, match="frame 2: gone"):
        write_video(breaking(), path, fps=24)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("code", [0, 1])
def test_a_failing_encoder_leaves_nothing(code, tmp_path, monkeypatch):
    program = tmp_path / "ffmpeg"
    program.write_text(f"#!/bin/sh\nexit {code}\n")
    program.chmod(0o755)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(program))
    with pytest.raises(UserError, match=r"film\.mp4: cannot be written"):
        write_video(frames(50, 256, 256), tmp_path / "out" / "film.mp4", fps=24)
    assert list((tmp_path / "out").iterdir()) == []


def test_a_missing_encoder_is_reported_with_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(MissingDependencyError, match=r"pip install \"rfpp\[video\]\""):
        require_encoder()
