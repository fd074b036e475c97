"""Sweet Home 3D furniture libraries (.sh3f): zip archives of models with a catalogue in a properties file.

The format: https://www.sweethome3d.com/documentation.jsp, "Furniture library files".
"""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from rfpp.errors import SceneError
from rfpp.scene.io.limits import MAX_ENTRIES

_CATALOGUE = "PluginFurnitureCatalog.properties"
_MAX_CATALOGUE_BYTES = 2**24
#: What zipfile raises of damaged, encrypted and unusually compressed archives.
_UNREADABLE = (zipfile.BadZipFile, NotImplementedError, RuntimeError, ValueError, EOFError)


@dataclass(frozen=True)
class Furniture:
    """The catalogue of one archive.

    Attributes:
        name, license, provider: what the catalogue says of itself; the license is empty where it says nothing.
        creators: of its models, each once.
        models: name of the model's file in the archive, by the id of the piece of furniture.
    """

    name: str
    license: str
    provider: str
    creators: tuple[str, ...]
    models: dict[str, str]

    @classmethod
    def read(cls, path: Path) -> Furniture:
        """Raises SceneError naming the archive and what is wrong with it."""
        values = _properties(read_member(path, _CATALOGUE, _MAX_CATALOGUE_BYTES).decode("latin-1"))
        numbers = sorted({key.partition("#")[2] for key in values if key.startswith("model#")}, key=_number)
        if not numbers:
            raise SceneError(f"{path}: its catalogue names no model: give a library of furniture")
        if len(numbers) > MAX_ENTRIES:
            raise SceneError(f"{path}: its catalogue names {len(numbers):,} models, {MAX_ENTRIES:,} are read at most")
        names = {number: values[f"model#{number}"].lstrip("/") for number in numbers}
        return cls(
            name=values.get("name", path.stem),
            license=values.get("license", ""),
            provider=values.get("provider", ""),
            creators=tuple(sorted({values[key] for n in numbers if (key := f"creator#{n}") in values})),
            models={values.get(f"id#{n}", PurePosixPath(name).stem): name for n, name in names.items()},
        )


def read_member(path: Path, name: str, limit: int) -> bytes:
    """A file in a zip archive. Raises SceneError naming the archive: not there, damaged, above `limit` bytes."""
    try:
        with zipfile.ZipFile(path) as archive, archive.open(name) as member:
            content = member.read(limit + 1)
    except KeyError:
        raise SceneError(f"{path}: holds no {name}: give a whole archive") from None
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({error.strerror or error}): correct the path") from None
    except _UNREADABLE as error:
        raise SceneError(f"{path}: {name} cannot be unpacked ({error}): fetch the archive again") from None
    if len(content) > limit:
        raise SceneError(f"{path}: {name} holds more than {limit:,} bytes: take it out of the archive")
    return content


def _properties(text: str) -> dict[str, str]:
    """`key=value` lines of a Java properties file; continued lines and escapes do not occur in what is read of it."""
    pairs = (line.split("=", 1) for line in text.splitlines() if "=" in line and not line.startswith(("#", "!")))
    return {key.strip(): value.strip() for key, value in pairs}


def _number(text: str) -> tuple[int, str]:
    return (int(text) if text.isdecimal() else 0, text)
