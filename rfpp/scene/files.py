"""Writing files so that a reader never sees half of one."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from rfpp.errors import UserError


def write_atomically(path: Path, content: bytes) -> Path:
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
        os.replace(temporary, path)
    except OSError as error:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)
        raise UserError(f"{path}: cannot be written ({error.strerror}): free space or choose another place") from None
    return path
