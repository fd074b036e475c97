"""Package Blender's add-on as an extension, a zip file."""

from __future__ import annotations

import io
import tomllib
import zipfile
from pathlib import Path

from rfpp.files import write_atomically

#: Source of the add-on, which runs inside Blender only.
FOLDER = Path(__file__).parent / "addon"
_MANIFEST = FOLDER / "blender_manifest.toml"
_EPOCH = (1980, 1, 1, 0, 0, 0)  # for reproducible bytes


def write_extension(target: Path) -> Path:
    """Write the zip file that Blender installs, at a path that ends in .zip or in a folder, and return its path."""
    if target.suffix != ".zip":
        manifest = tomllib.loads(_MANIFEST.read_text(encoding="utf-8"))
        target /= f"{manifest['id']}-{manifest['version']}.zip"
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted((_MANIFEST, *FOLDER.glob("*.py"))):
            archive.writestr(zipfile.ZipInfo(file.name, _EPOCH), file.read_bytes(), zipfile.ZIP_DEFLATED)
    return write_atomically(target, content.getvalue())
