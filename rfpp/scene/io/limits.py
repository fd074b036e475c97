"""Reading what others wrote: in bounded memory, and from the folder of the file alone.

What a file says of itself (counts, offsets, names of other files) is checked against what is there before anything is
allocated or opened.
"""

from __future__ import annotations

import json
import re
import stat
from pathlib import Path
from typing import Any

from rfpp.errors import SceneError, one_line

#: A mesh or an image file of more bytes is refused unread.
MAX_BYTES = 2**29
#: The same of text, whose numbers are read line by line.
MAX_TEXT_BYTES = 2**27
#: A polygon of a hundred thousand corners.
MAX_LINE_BYTES = 2**20
#: A text that is parsed into Python objects, which take up to thirty times its size.
MAX_JSON_BYTES = 2**25
#: Forty times what networks are trained for, and what loads within ten seconds and 2 GB on two cores.
MAX_TRIANGLES = 3_000_000
#: Lines of a text that are read one by one, which takes microseconds each.
MAX_SINGLE_LINES = 1_000_000
#: Entries of any list that become Python objects, and parts of a scene.
MAX_ENTRIES, MAX_PARTS = 100_000, 20_000


def read_bytes(path: Path, limit: int = MAX_BYTES, smaller: str = "make it smaller") -> bytes:
    """The content of a regular file. Raises SceneError, without the name: missing, unreadable, empty, above `limit`."""
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise SceneError("is not a regular file: correct the path")
        if status.st_size > limit:
            raise SceneError(f"holds {status.st_size:,} bytes, of which {limit:,} are read at most: {smaller}")
        content = path.read_bytes()
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the name
        reason = getattr(error, "strerror", None) or error
        raise SceneError(f"cannot be read ({reason}): correct the path") from None
    if not content:
        raise SceneError("is empty: export it again")
    return content


def parse_json(content: bytes, expected: str) -> dict[str, Any]:
    """The JSON object in a text.

    Raises:
        SceneError: malformed, nested too deeply, with a repeated key, or no object at all; `expected` says what was.
    """
    try:
        parsed = json.loads(content.decode("utf-8"), object_pairs_hook=_without_repeats)
    except UnicodeDecodeError:
        raise SceneError(f"is not UTF-8 text: give {expected}") from None
    except json.JSONDecodeError as error:
        raise SceneError(f"line {error.lineno}: malformed JSON, {error.msg}: correct it") from None
    except RecursionError:
        raise SceneError(f"its JSON is nested too deeply: give {expected}") from None
    except ValueError:  # Python converts no number of thousands of digits
        raise SceneError("malformed JSON, a number has thousands of digits: correct it") from None
    if not isinstance(parsed, dict):
        raise SceneError(f"is not a JSON object: give {expected}")
    return parsed


def beside(folder: Path, name: str) -> Path:
    """The file that another one in `folder` names: in that folder or below it.

    Symbolic links are followed: they are made by whoever owns the folder, never by a file in it.

    Raises:
        SceneError: a URL, an absolute path, or one that leads out of the folder.
    """
    parts = name.replace("\\", "/").split("/")
    if re.match(r"[A-Za-z][A-Za-z0-9+.-]+:", name) or not name.isprintable():
        raise SceneError(f"'{one_line(name)}' is no path of a file: put the file beside this one and name it")
    if not parts[0] or parts[0].endswith(":") or ".." in parts:
        raise SceneError(f"'{name}' leads out of the file's folder: copy it there and give its path relative to it")
    return folder.joinpath(*parts)


def require_bounded(triangles: int, parts: int = 0) -> None:
    """Raises SceneError for more triangles or parts than are ever held."""
    if parts > MAX_PARTS:
        raise SceneError(f"more than {MAX_PARTS:,} parts: join them where they were made")
    if triangles > MAX_TRIANGLES:
        raise SceneError(f"{triangles:,} triangles are more than {MAX_TRIANGLES:,}: decimate it where it was made")


def _without_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        seen: set[str] = set()
        repeated = next(key for key, _ in pairs if key in seen or seen.add(key))
        raise SceneError(f"the key '{one_line(repeated)}' occurs twice in one place: rename or remove one")
    return content
