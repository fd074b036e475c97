"""Objects from Objaverse 1.0, by their uids."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
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
from rfpp.scene.sampling.objects.prepared import Original, PreparedObjects

#: The package reads its table of all objects once per call, which takes a second: so many uids at a time.
_UIDS_PER_DOWNLOAD = 100
_UID = re.compile(r"[0-9a-f]{32}")


@dataclass(frozen=True)
class ObjaverseObjects(PreparedObjects):
    """Objects that a list of Objaverse uids names; the `objaverse` package downloads them, to its own cache.

    Attributes:
        uids: a text file with one uid a line (# begins a comment), or a JSON list. Its stem is the library's name.
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
        """What a uid names never changes."""
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
        """The uids in the file, in order and each once."""
        path = Path(self.uids).expanduser().absolute()
        try:
            return _listed(path, path.stat().st_mtime_ns)
        except OSError as error:
            raise SceneError(f"{path}: cannot be read ({error.strerror}): give a file of Objaverse uids") from None


@lru_cache(maxsize=4)  # every scene asks whether the library is that of this list
def _listed(path: Path, _changed: int) -> list[str]:
    try:
        uids = _parsed(path, path.read_text(encoding="utf-8"))
    except UnicodeDecodeError:
        raise SceneError(f"{path}: is not UTF-8 text: give a file of Objaverse uids") from None
    if wrong := [uid for uid in uids if not (isinstance(uid, str) and _UID.fullmatch(uid))]:
        raise SceneError(f"{path}: '{wrong[0]}' is no Objaverse uid: write 32 hexadecimal digits")
    if not uids:
        raise SceneError(f"{path}: names no uid: write one a line, or a JSON list")
    return sorted(set(uids))


def _parsed(path: Path, text: str) -> list[Any]:
    if path.suffix.lower() != ".json":
        return [uid for line in text.splitlines() if (uid := line.split("#")[0].strip())]
    try:
        uids = json.loads(text)
    except json.JSONDecodeError as error:
        raise SceneError(f"{path}: line {error.lineno}: malformed JSON, {error.msg}: correct it") from None
    if not isinstance(uids, list):
        raise SceneError(f"{path}: is no JSON list: write a list of uids")
    return uids


def _downloaded(uids: list[str]) -> dict[str, str]:
    """The local file of each uid, without those that Objaverse does not have.

    Raises:
        MissingDependencyError: the package is not installed.
        UserError: the network failed.
    """
    package = _package()
    # The package prints a line per file and warns of every uid that it does not know.
    with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return package.load_objects(uids)
        except urllib.error.HTTPError as error:
            if len(uids) == 1 and error.code in (403, 404, 410):  # taken down by its author
                return {}
            if len(uids) == 1:
                raise _network_failure(error) from None
        except (OSError, EOFError) as error:
            raise _network_failure(error) from None
    return {uid: path for one in uids for uid, path in _downloaded([one]).items()}


def _network_failure(error: Exception) -> UserError:
    reason = getattr(error, "reason", None) or error
    return UserError(f"Objaverse cannot be downloaded ({reason}): connect and run the same command again to go on")


def _package() -> ModuleType:
    try:
        import objaverse
    except ImportError:
        raise MissingDependencyError(
            "the package objaverse, which downloads the objects, is missing: pip install -e '.[objaverse]'"
        ) from None
    return objaverse
