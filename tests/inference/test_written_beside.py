"""Images are written while others are rendered: all of them, and no more once writing has failed."""

import errno
from threading import Event

import numpy as np
import pytest

import launch.render
from launch.render import written_beside
from rfpp.exr import read_exr

IMAGES = np.random.default_rng(0).uniform(0, 1, (4, 8, 8, 3)).astype(np.float32)


def test_every_image_is_written_to_its_own_file(tmp_path):
    targets = [tmp_path / f"{i}.exr" for i in range(4)]
    kept = written_beside(iter(IMAGES), targets)
    np.testing.assert_array_equal(kept, IMAGES)
    for target, image in zip(targets, IMAGES, strict=True):
        np.testing.assert_array_equal(read_exr(target)["RGB"], image.astype(np.float16))
        assert target.with_suffix(".png").exists()


def test_an_image_is_written_while_the_next_one_is_rendered(monkeypatch):
    begun, finish = Event(), Event()

    def write(image, target):
        begun.set()
        assert finish.wait(timeout=60)

    def rendering():
        yield IMAGES[0]
        assert begun.wait(timeout=60)
        finish.set()
        yield IMAGES[1]

    monkeypatch.setattr(launch.render, "write_pictures", write)
    assert len(written_beside(rendering(), ["a", "b"])) == 2


def test_nothing_more_is_rendered_for_a_full_disk(monkeypatch):
    rendered = []

    def write(image, target):
        raise OSError(errno.ENOSPC, "No space left on device", target)

    def rendering():
        for number, image in enumerate(IMAGES):
            rendered.append(number)
            yield image

    monkeypatch.setattr(launch.render, "write_pictures", write)
    with pytest.raises(OSError, match="No space left"):
        written_beside(rendering(), list("abcd"))
    assert rendered == [0, 1]
