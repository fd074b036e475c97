"""Atomic writes and safe file names."""

from __future__ import annotations

import os
import re
import tempfile
from pathlib import Path

from rfpp.errors import UserError


def write_atomically(path: Path, content: bytes | memoryview) -> Path:
    """Write `content` to a temporary file beside `path`, rename it, and return `path`. Missing folders are created.

    Raises:
        UserError: If the file cannot be written, for example because the disk is full; no temporary file remains.
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
    """Return whether untrusted text may name a file: letters, digits, dots, dashes, underscores."""
    return isinstance(name, str) and re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,199}", name) is not None


def as_file_name(text: str) -> str:
    """Return the closest plain file name."""
    return re.sub(r"[^A-Za-z0-9_.-]", "_", text).lstrip(".-")[:200] or "unnamed"
