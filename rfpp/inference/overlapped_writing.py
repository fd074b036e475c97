"""Files are written while the next image is rendered."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Image = TypeVar("Image")
Target = TypeVar("Target")


def written_beside(
    images: Iterable[Image], targets: Iterable[Target], write: Callable[[Image, Target], object]
) -> Iterator[Image]:
    """The images, each of which a thread writes to its target while the next one is rendered."""
    with ThreadPoolExecutor(1, "writing") as beside:
        writing = None
        for image, target in zip(images, targets, strict=True):
            if writing:
                writing.result()  # raises what went wrong: nothing more is rendered for a full disk
            writing = beside.submit(write, image, target)
            yield image
        if writing:
            writing.result()
