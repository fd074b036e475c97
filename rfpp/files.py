"""Atomic writes and safe file names."""

from __future__ import annotations

import os
import re
import tempfile
from pathlib import Path

from rfpp.errors import UserError


def write_atomically(path: Path, content: bytes | memoryview) -> Path:
    """Write `content` to a temporary name beside `path` (folders are made) and move it into place; returns `path`.

    Raises:
        UserError: the disk is full, the folder cannot be written, and the like; nothing is left behind.
    """
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, prefix=f".{path.name}.", delete=False) as file:
            temporary = file.name
            os.fchmod(file.fileno(), 0o644)  # mkstemp makes it private
            file.write(content)
            file.flush()
            os.fsync(file.fileno())  # or a crash of the machine could leave the new name on an empty file
        os.replace(temporary, path)
    except OSError as error:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)
        raise UserError(f"{path}: cannot be written ({error.strerror}): free space or choose another place") from None
    return path


def is_plain_name(name: object) -> bool:
    """Whether text from outside may name a file: letters, digits, dots, dashes, underscores."""
    return isinstance(name, str) and re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,199}", name) is not None


def as_file_name(text: str) -> str:
    """A plain name that is as near to the text as can be."""
    return re.sub(r"[^A-Za-z0-9_.-]", "_", text).lstrip(".-")[:200] or "unnamed"
