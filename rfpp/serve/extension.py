"""Blender's add-on as an extension: one zip file."""

from __future__ import annotations

import io
import tomllib
import zipfile
from pathlib import Path

from rfpp.files import write_atomically

#: What runs inside Blender, and nowhere else.
FOLDER = Path(__file__).parent / "addon"
_MANIFEST = "blender_manifest.toml"
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the same files give the same bytes


def write_extension(target: Path) -> Path:
    """Write the zip file that Blender installs; returns its path.

    Args:
        target: the file, if it ends in .zip, or a folder for it.

    Raises:
        UserError: it cannot be written.
    """
    about = tomllib.loads((FOLDER / _MANIFEST).read_text(encoding="utf-8"))
    if target.suffix != ".zip":
        target /= f"{about['id']}-{about['version']}.zip"
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted((FOLDER / _MANIFEST, *FOLDER.glob("*.py"))):
            archive.writestr(zipfile.ZipInfo(file.name, _EPOCH), file.read_bytes(), zipfile.ZIP_DEFLATED)
    return write_atomically(target, content.getvalue())
