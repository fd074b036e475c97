"""Objects from Objaverse 1.0, by their uids."""

from __future__ import annotations

import contextlib
import hashlib
import io
import re
import urllib.error
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import islice
from pathlib import Path
from types import ModuleType
from typing import Any

from rfpp.errors import MissingDependencyError, SceneError, UserError
from rfpp.scene.sampling.objects.library_objects import LibraryObjects, Original

#: The package reads its table of all objects once per call, which takes a second.
_UIDS_PER_DOWNLOAD = 100


@dataclass(frozen=True)
class ObjaverseObjects(LibraryObjects):
    """The objects of a list of Objaverse uids; the `objaverse` package downloads them to its own cache.

    Attributes:
        uids: a text file with one uid per line (# begins a comment), or a JSON list. Its stem names the library.
    """

    uids: str | None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.uids:
            raise SceneError("family.objects.uids is not given: add family.objects.uids=/my/uids.txt")

    @property
    def name(self) -> str:
        return f"objaverse-{Path(self.uids).stem}"

    def originals(self) -> list[Original]:
        """Return the listed objects, which never change."""
        return [Original(uid, stamp="objaverse 1.0") for uid in self._listed()]

    def origin(self) -> dict[str, Any]:
        return {"objaverse": hashlib.sha256("\n".join(self._listed()).encode()).hexdigest()}

    def fetched(self, originals: Iterable[Original]) -> Iterator[Original]:
        remaining = iter(originals)
        while batch := list(islice(remaining, _UIDS_PER_DOWNLOAD)):
            paths = _downloaded([original.id for original in batch])
            for original in batch:
                path = paths.get(original.id)
                yield replace(original, path=None if path is None else Path(path))

    def _listed(self) -> list[str]:
        path = Path(self.uids).expanduser().absolute()
        try:
            return _listed(path, path.stat().st_mtime_ns)
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or "not UTF-8 text"
            raise SceneError(f"{path}: cannot be read ({reason}): give a file of Objaverse uids") from None


@lru_cache(maxsize=4)  # every scene compares the library's settings with this list
def _listed(path: Path, _modified: int) -> list[str]:
    lines = [line.split("#")[0] for line in path.read_text(encoding="utf-8").splitlines()]
    uids = re.findall(r'[^\s,"\[\]]+', "\n".join(lines))
    if wrong := [uid for uid in uids if not re.fullmatch(r"[0-9a-f]{32}", uid)]:
        raise SceneError(f"{path}: '{wrong[0]}' is not an Objaverse uid: write 32 hexadecimal digits")
    if not uids:
        raise SceneError(f"{path}: names no uid: write one per line, or a JSON list")
    return sorted(set(uids))


def _downloaded(uids: list[str]) -> dict[str, str]:
    """Download objects; return the local file of each available one.

    Raises:
        MissingDependencyError: If the package is not installed.
    """
    package = _package()
    # the package prints a line per file and warns of every unknown uid
    with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return package.load_objects(uids)
        except urllib.error.HTTPError as error:
            if len(uids) == 1 and error.code in (403, 404, 410):  # removed by its author
                return {}
            if len(uids) == 1:
                raise _network_failure(error) from None
        except (OSError, EOFError) as error:
            raise _network_failure(error) from None
    return {uid: path for one in uids for uid, path in _downloaded([one]).items()}


def _network_failure(error: Exception) -> UserError:
    reason = getattr(error, "reason", None) or error
    return UserError(f"Objaverse cannot be downloaded ({reason}): connect and run the same command again to resume")


def _package() -> ModuleType:
    try:
        import objaverse
    except ImportError:
        raise MissingDependencyError(
            "downloading Objaverse objects needs the package objaverse: pip install -e '.[objaverse]'"
        ) from None
    return objaverse
