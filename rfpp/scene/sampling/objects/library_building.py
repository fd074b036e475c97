"""Build an object library in parallel; interrupted builds resume."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rfpp.errors import SceneError, UserError
from rfpp.files import write_atomically
from rfpp.scene.sampling.objects.library import (
    INDEX,
    Index,
    Library,
    LibraryObject,
    Prepared,
    Rejected,
    StrictModel,
    encoded_mesh,
    mesh_path,
    record_path,
)
from rfpp.scene.sampling.objects.library_objects import LibraryObjects, Original
from rfpp.scene.sampling.objects.preparation import Preparation, RejectionError

#: Yields (item, what the job returned or raised), like `RenderFarm.map`.
Map = Callable[[Callable[[Any], Any], Iterable[Any]], Iterator[tuple[Any, Any]]]


class Record(StrictModel):
    """The outcome for an original with this stamp under this preparation."""

    stamp: str
    preparation: dict[str, Any]
    outcome: Prepared | Rejected


def prepare(source: LibraryObjects, map: Map, progress: Callable[[int, int], None]) -> Library:
    """Build the library of a source, or its missing and changed objects.

    Raises:
        UserError: If originals cannot be fetched, a file cannot be written, or fewer than two objects result.
    """
    originals = source.originals()
    job = PrepareOriginal(source.library_root, source.preparation)
    outcomes = {o.id: outcome for o in originals if (outcome := job.recorded(o)) is not None}
    missing = [o for o in originals if o.id not in outcomes]
    progress(len(outcomes), len(originals))
    for original, result in map(job, source.fetched(missing)):
        outcomes[original.id] = _outcome(original, result)
        progress(len(outcomes), len(originals))
    index = _index(source, [outcomes[o.id] for o in originals])
    content = json.dumps(index.model_dump(exclude_defaults=True), indent=1, ensure_ascii=False) + "\n"
    write_atomically(source.library_root / INDEX, content.encode())
    return Library.load(source.library_root)


@dataclass(frozen=True)
class PrepareOriginal:
    """Task that prepares one original and records the outcome; picklable."""

    root: Path
    preparation: Preparation

    def __call__(self, original: Original) -> Prepared | Rejected:
        """Return the recorded outcome. Raises UserError if it cannot be written."""
        outcome = self._outcome(original)
        record = Record(stamp=original.stamp, preparation=asdict(self.preparation), outcome=outcome)
        write_atomically(record_path(self.root, original.id), record.model_dump_json().encode())
        return outcome

    def recorded(self, original: Original) -> Prepared | Rejected | None:
        """Return the recorded outcome if it is still valid and its mesh exists."""
        try:
            record = Record.model_validate_json(record_path(self.root, original.id).read_bytes())
        except (OSError, ValueError):  # missing or damaged
            return None
        outcome = record.outcome
        if (record.stamp, record.preparation) != (original.stamp, asdict(self.preparation)):
            return None
        if isinstance(outcome, Prepared):
            path = mesh_path(self.root, original.id)
            if not path.is_file() or _sha256(path) != outcome.mesh_sha256:
                return None
        return outcome

    def _outcome(self, original: Original) -> Prepared | Rejected:
        if original.path is None:
            return Rejected(id=original.id, sha256=None, reason="not available", detail="it could not be downloaded")
        sha256 = None
        try:
            with original.file() as path:
                sha256 = _sha256(path)
                prepared = self.preparation(path)
        except (OSError, SceneError) as error:
            detail = getattr(error, "strerror", None) or str(error)
            return Rejected(id=original.id, sha256=sha256, reason="unreadable", detail=detail)
        except RejectionError as error:
            return Rejected(id=original.id, sha256=sha256, reason=error.reason, detail=error.detail)
        content = encoded_mesh(prepared.parts)
        write_atomically(mesh_path(self.root, original.id), content)
        return Prepared(
            id=original.id,
            sha256=sha256,
            mesh_sha256=hashlib.sha256(content).hexdigest(),
            faces_before=prepared.faces_before,
            faces=sum(map(len, prepared.parts)),
            watertight=prepared.watertight,
            parts=len(prepared.parts),
        )


def _outcome(original: Original, result: Any) -> Prepared | Rejected:
    """Return a job's result; a job that crashed its process is not recorded, so that it is retried next time."""
    if isinstance(result, UserError):
        raise result
    if isinstance(result, Exception):
        detail = f"{type(result).__name__}: {result}".splitlines()[0]
        return Rejected(id=original.id, sha256=None, reason="crashed", detail=detail)
    return result


def _index(source: LibraryObjects, outcomes: list[Prepared | Rejected]) -> Index:
    """Return the library's index, in which equal meshes occur once."""
    first: dict[str, str] = {}
    prepared: list[Prepared] = []
    rejected: list[Rejected] = []
    for outcome in outcomes:
        if isinstance(outcome, Rejected):
            rejected.append(outcome)
        elif (twin := first.setdefault(outcome.mesh_sha256, outcome.id)) != outcome.id:
            detail = f"the same mesh as {twin}"
            rejected.append(Rejected(id=outcome.id, sha256=outcome.sha256, reason="duplicate", detail=detail))
        else:
            prepared.append(outcome)
    reasons = Counter(item.reason for item in rejected)
    if len(prepared) < 2:
        why = ", ".join(f"{count} {reason}" for reason, count in reasons.most_common()) or "none"
        raise SceneError(
            f"{source.library_root}: {len(prepared)} of {len(outcomes)} meshes became objects (rejected: {why}), and "
            "two are needed, one for training and one for test scenes: add meshes or change family.objects.preparation"
        )
    held_out = _held_out([item.id for item in prepared], source.held_out)
    objects = [
        LibraryObject(**item.model_dump(), part="held_out" if item.id in held_out else "train") for item in prepared
    ]
    return Index(
        version=1,
        settings=source.settings(),
        counts=dict(Counter(item.part for item in objects)) | dict(sorted(reasons.items())),
        objects=tuple(objects),
        rejected=tuple(rejected),
        attribution=source.attribution(),
    )


def _held_out(ids: list[str], share: float) -> set[str]:
    """Return the ids whose hash, as a number in [0, 1), is below `share`, independently of the other ids.

    The lowest id is always held out and the highest never, so that both parts have an object.
    """
    numbers = {i: int.from_bytes(hashlib.sha256(i.encode()).digest()[:8], "big") / 2**64 for i in ids}
    ordered = sorted(ids, key=numbers.__getitem__)
    return {ordered[0], *(i for i in ordered if numbers[i] < share)} - {ordered[-1]}


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
