"""Files of keyframes: YAML or JSON, read without executing or expanding anything in them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, TypeVar

import yaml
from pydantic import Field

from rfpp.errors import SceneError
from rfpp.inference.motion.interpolation import Curve, bounded, flowing
from rfpp.scene.io.limits import parse_json, read_bytes
from rfpp.scene.spec import Camera, Strict

#: Far more than anyone writes, and read in seconds.
_MAX_BYTES = 1 << 20

Content = TypeVar("Content", bound=Strict)
Key = TypeVar("Key", bound=Strict)
#: Keys as they stand in a file.
Entries = tuple[dict[str, Any], ...]
#: In seconds; nobody films longer than a day.
Time = Annotated[float, Field(ge=0, le=86400)]


class CameraKey(Camera):
    """A camera at a time in seconds."""

    noun = ""

    time: Time


class CameraTrack:
    """A camera that passes through keys: its place and what it looks at on splines, its angle between its keys'.

    Args:
        entries: the keys.
        where: they stand, for messages.

    Raises:
        SceneError: a wrong key, none, or times that do not increase.
    """

    def __init__(self, entries: Entries, where: str):
        self._where = where
        with located(where):
            keys = made_keys(CameraKey, entries)
            self.times = increasing_times(keys)
        self._curves: dict[str, Curve] = {
            "position": flowing(self.times, [key.position for key in keys]),
            "look_at": flowing(self.times, [key.look_at for key in keys]),
            "up": flowing(self.times, [key.up for key in keys]),
            "fov": bounded(self.times, [key.fov for key in keys]),
        }

    def at(self, time: float | int) -> Camera:
        """Raises SceneError where the curves between keys make no camera, as one that looks along its up vector."""
        with located(f"{self._where}, time {time:g}"):
            return Camera(**{name: curve(time).tolist() for name, curve in self._curves.items()})


def made_keys(kind: type[Key], entries: Entries) -> list[Key]:
    """The keys of a file. Raises SceneError naming the number of a wrong one, from 0."""
    keys = []
    for number, values in enumerate(entries):
        with located(f"key {number}"):
            keys.append(kind(**values))
    return keys


def increasing_times(keys: Sequence[Any]) -> list[float]:
    """Of the keys. Raises SceneError if there is none or they are not in order."""
    times = [key.time for key in keys]
    if not times:
        raise SceneError("there is no key: add one")
    for before, after in pairwise(times):
        if after <= before:
            raise SceneError(f"time {after:g} follows {before:g}: put the keys in order, each time once")
    return times


def read_keys(path: Path, content: type[Content]) -> Content:
    """The file's content. Raises SceneError naming the file, the key and the fix."""
    with located(str(path)):
        text = read_bytes(path, _MAX_BYTES)
        expected = "keyframes in YAML or JSON"
        values = parse_json(text, expected) if path.suffix == ".json" else _parsed_yaml(text, expected)
        return content(**values)


def _parsed_yaml(text: bytes, expected: str) -> dict[str, Any]:
    try:
        values = yaml.load(text.decode("utf-8"), _PlainLoader)
    except UnicodeDecodeError:
        raise SceneError(f"is not UTF-8 text: give {expected}") from None
    except yaml.MarkedYAMLError as error:
        line = f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""
        raise SceneError(f"{line}malformed YAML, {error.problem or error.context}: correct it") from None
    except (yaml.YAMLError, RecursionError, ValueError):  # forbidden characters, deep nesting, a 13th month
        raise SceneError(f"malformed YAML: give {expected}") from None
    if not isinstance(values, dict) or not all(isinstance(key, str) for key in values):
        raise SceneError(f"is no mapping of names: give {expected}")
    return values


@contextmanager
def located(where: str) -> Iterator[None]:
    """Put `where` in front of the message of any SceneError raised inside."""
    try:
        yield
    except SceneError as error:
        raise SceneError(f"{where}: {error}") from None


class _PlainLoader(yaml.SafeLoader):
    """YAML without aliases, by which a small file can stand for gigabytes, and without repeated keys."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node:
        if self.check_event(yaml.AliasEvent):
            raise yaml.MarkedYAMLError(problem="aliases (*) are not read", problem_mark=self.peek_event().start_mark)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        mapping = super().construct_mapping(node, deep)
        if len(mapping) < len(node.value):
            raise yaml.MarkedYAMLError(problem="a key occurs twice in one place", problem_mark=node.start_mark)
        return mapping
