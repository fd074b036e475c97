"""Reading untrusted files: in bounded memory, and only from the file's own folder.

Counts, offsets and names of other files in a file are checked before anything is allocated or opened.
"""

from __future__ import annotations

import json
import lzma
import os
import re
import stat
import zipfile
import zlib
from pathlib import Path
from typing import Any

from rfpp.errors import SceneError, one_line

#: Limit of mesh and image files in bytes.
MAX_BYTES = 2**29
#: Limit of text files in bytes.
MAX_TEXT_BYTES = 2**27
#: Limit of text that is parsed into Python objects, which take up to thirty times its size.
MAX_JSON_BYTES = 2**25
#: Forty times the triangles of training scenes.
MAX_TRIANGLES = 3_000_000
#: Limits of list entries that become Python objects, and of parts of a scene.
MAX_ENTRIES, MAX_PARTS = 100_000, 20_000

#: Limits of file systems for the bytes of a path and of its parts.
_MAX_PATH, _MAX_NAME = 4000, 255

#: Errors of zipfile for damaged, encrypted and unusually compressed archives.
_BAD_ZIP = (
    zipfile.BadZipFile, NotImplementedError, RuntimeError, ValueError, EOFError, zlib.error, lzma.LZMAError,
)  # fmt: skip


def read_bytes(path: Path, limit: int = MAX_BYTES, smaller: str = "make it smaller") -> bytes:
    """Read a regular file. Raises SceneError, without its name, if it is missing, unreadable, empty or too large."""
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise SceneError("is not a regular file: correct the path")
        if status.st_size > limit:
            raise SceneError(f"holds {status.st_size:,} bytes, the limit is {limit:,}: {smaller}")
        content = path.read_bytes()
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the name
        reason = getattr(error, "strerror", None) or error
        raise SceneError(f"cannot be read ({reason}): correct the path") from None
    if not content:
        raise SceneError("is empty: export it again")
    return content


def read_member(path: Path, name: str, limit: int) -> bytes:
    """Read a file in a zip archive. Raises SceneError if it is missing, damaged or larger than `limit` bytes."""
    if path.exists() and not path.is_file():
        raise SceneError(f"{path}: is not a regular file: correct the path")
    try:
        with zipfile.ZipFile(path) as archive, archive.open(name) as member:
            content = member.read(limit + 1)
    except KeyError:
        raise SceneError(f"{path}: holds no {name}: give a complete archive") from None
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({error.strerror or error}): correct the path") from None
    except _BAD_ZIP as error:
        raise SceneError(f"{path}: {name} cannot be unpacked ({error}): fetch the archive again") from None
    if len(content) > limit:
        raise SceneError(f"{path}: {name} holds more than {limit:,} bytes: remove it from the archive")
    return content


def parse_json(content: bytes, expected: str) -> dict[str, Any]:
    """Parse the JSON object in a text.

    Raises:
        SceneError: If it is malformed, nested too deeply, has a repeated key, or is not an object; `expected` names
            the expected content.
    """
    try:
        parsed = json.loads(content.decode("utf-8-sig"), object_pairs_hook=_without_repeats)
    except UnicodeDecodeError:
        raise SceneError(f"is not UTF-8 text: give {expected}") from None
    except json.JSONDecodeError as error:
        raise SceneError(f"line {error.lineno}: malformed JSON, {error.msg}: correct it") from None
    except RecursionError:
        raise SceneError(f"its JSON is nested too deeply: give {expected}") from None
    except ValueError:  # Python refuses numbers of thousands of digits
        raise SceneError("malformed JSON, a number has thousands of digits: correct it") from None
    if not isinstance(parsed, dict):
        raise SceneError(f"is not a JSON object: give {expected}")
    return parsed


def beside(folder: Path, name: str) -> Path:
    """Return the path of a file named by another file in `folder`, inside that folder.

    Symbolic links are followed: the owner of the folder creates them, not the files in it.

    Raises:
        SceneError: If the name is a URL, an absolute path, too long for one, or leads out of the folder.
    """
    parts = name.replace("\\", "/").split("/")
    if re.match(r"[A-Za-z][A-Za-z0-9+.-]+:", name) or not name.isprintable():
        raise SceneError(f"'{one_line(name)}' is not a file path: put the file beside this one and name it")
    if not parts[0] or parts[0].endswith(":") or ".." in parts:
        raise SceneError(f"'{name}' leads out of the file's folder: copy it there and give its path relative to it")
    if len(os.fsencode(folder / name)) > _MAX_PATH or max(len(os.fsencode(part)) for part in parts) > _MAX_NAME:
        raise SceneError(f"'{one_line(name, 40)}' is too long for a file path: shorten it")
    return folder.joinpath(*parts)


def require_bounded(triangles: int, parts: int = 0) -> None:
    """Raise SceneError if there are too many triangles or parts."""
    if parts > MAX_PARTS:
        raise SceneError(f"more than {MAX_PARTS:,} parts: join them in the original program")
    if triangles > MAX_TRIANGLES:
        raise SceneError(
            f"{triangles:,} triangles are more than {MAX_TRIANGLES:,}: decimate it in the original program"
        )


def _without_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        seen: set[str] = set()
        repeated = next(key for key, _ in pairs if key in seen or seen.add(key))
        raise SceneError(f"the key '{one_line(repeated)}' occurs twice in one place: rename or remove one")
    return content
