"""Images are written while others are rendered: all of them, and no more once writing has failed."""

import errno
from threading import Event

import numpy as np
import pytest

from rfpp.imaging.exr import read_exr
from rfpp.imaging.tone_maps import Perceptual
from rfpp.inference.overlapped_writing import written_beside
from rfpp.inference.stills import write_still

IMAGES = np.random.default_rng(0).uniform(0, 1, (4, 8, 8, 3)).astype(np.float32)


def test_every_image_is_written_to_its_own_file(tmp_path):
    targets = [tmp_path / f"{i}.exr" for i in range(4)]
    tone_map = Perceptual()
    kept = list(written_beside(iter(IMAGES), targets, lambda image, target: write_still(image, target, tone_map)))
    np.testing.assert_array_equal(kept, IMAGES)
    for target, image in zip(targets, IMAGES, strict=True):
        np.testing.assert_array_equal(read_exr(target)["RGB"], image.astype(np.float16))
        assert target.with_suffix(".png").exists()


def test_an_image_is_written_while_the_next_one_is_rendered():
    begun, finish = Event(), Event()

    def write(image, target):
        begun.set()
        assert finish.wait(timeout=60)

    def rendering():
        yield IMAGES[0]
        assert begun.wait(timeout=60)
        finish.set()
        yield IMAGES[1]

    assert len(list(written_beside(rendering(), ["a", "b"], write))) == 2


def test_nothing_more_is_rendered_for_a_full_disk():
    rendered = []

    def write(image, target):
        raise OSError(errno.ENOSPC, "No space left on device", target)

    def rendering():
        for number, image in enumerate(IMAGES):
            rendered.append(number)
            yield image

    with pytest.raises(OSError, match="No space left"):
        list(written_beside(rendering(), list("abcd"), write))
    assert rendered == [0, 1]


def test_no_images_are_no_work():
    assert list(written_beside([], [], print)) == []
