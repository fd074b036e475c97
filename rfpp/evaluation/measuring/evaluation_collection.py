"""Many evaluations: found beneath folders, checked for comparability, and kept in one file, evaluations.json.

The evaluations of one study agree in most of what they say: data set, definitions, the baselines' scores. The file
holds that once, and of each evaluation only what is its own:

    {"shared": {"data": …, "splits": {"test": {"black": …}}}, "evaluations": [{"method": …, "splits": …}, …]}
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rfpp.errors import UserError
from rfpp.evaluation.measuring.evaluation_file import EVALUATION_FILE, Evaluation, reading, require_known_metrics
from rfpp.files import write_atomically

COLLECTION_FILE = "evaluations.json"


def read_evaluations(paths: Iterable[Path]) -> list[Evaluation]:
    """The evaluations in these files and folders, searched recursively, checked to be comparable.

    Copies of an evaluation, such as MLflow keeps, count once.

    Raises:
        UserError: nothing is found, a file is not an evaluation, a metric was not what it is now, or two files must not
            be compared: one data set in two versions, or one network (method, training, seed) twice on the same data.
    """
    unique: dict[str, tuple[Path, Evaluation]] = {}
    for path in paths:
        names = (EVALUATION_FILE, COLLECTION_FILE)
        found = sorted(file for name in names for file in path.rglob(name)) if path.is_dir() else [path]
        if not found:
            raise UserError(f"{path}: no {EVALUATION_FILE} anywhere beneath: make one with launch/evaluate.py")
        for file in found:
            for evaluation in _read(file):
                unique.setdefault(json.dumps(evaluation.to_json(), sort_keys=True), (file, evaluation))
    _require_comparable(unique.values())
    return [evaluation for _, evaluation in unique.values()]


def write_collection(evaluations: Sequence[Evaluation], path: Path) -> Path:
    """Write them into one file, one per line; returns its path. Raises UserError if it cannot be written."""
    contents = [evaluation.to_json() for evaluation in evaluations]
    shared = contents[0]
    for content in contents[1:]:
        shared = _shared(shared, content)
    lines = [json.dumps(_without(content, shared), allow_nan=False) for content in contents]
    records = ",\n  ".join(lines)
    text = f'{{\n "shared": {json.dumps(shared, allow_nan=False)},\n "evaluations": [\n  {records}\n ]\n}}\n'
    return write_atomically(path, text.encode())


def _read(path: Path) -> list[Evaluation]:
    """One evaluation or a collection, whatever the file is called."""
    with reading(path):
        content = json.loads(path.read_bytes())
        if "evaluations" not in content:
            return [Evaluation.from_json(content)]
        shared = content["shared"]
        return [Evaluation.from_json(_merged(shared, own)) for own in content["evaluations"]]


def _shared(a: Mapping[str, Any], b: Mapping[str, Any]) -> dict[str, Any]:
    """The common entries of two nested dictionaries."""
    common = {}
    for key in (key for key in a if key in b):
        if isinstance(a[key], dict) and isinstance(b[key], dict):
            common[key] = _shared(a[key], b[key])
        elif a[key] == b[key]:
            common[key] = a[key]
    return common


def _without(content: Mapping[str, Any], shared: Mapping[str, Any]) -> dict[str, Any]:
    """A nested dictionary without the shared entries; `_merged` restores them."""
    own = {}
    for key, value in content.items():
        if key not in shared:
            own[key] = value
        elif value != shared[key]:
            own[key] = _without(value, shared[key])
    return own


def _merged(shared: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    merged = {**shared, **own}
    for key in (key for key in own if key in shared):
        merged[key] = _merged(shared[key], own[key])
    return merged


def _require_comparable(evaluations: Iterable[tuple[Path, Evaluation]]) -> None:
    versions: dict[str, tuple[Path, str]] = {}
    networks: dict[str, Path] = {}
    for file, e in evaluations:
        require_known_metrics(e, file)
        data, network = f"the data set '{e.data}'", _identity(e)
        other, known = versions.setdefault(data, (file, e.data_manifest))
        if known != e.data_manifest:
            raise _different(file, data, other)
        if network in networks:
            raise _different(file, network, networks[network])
        networks[network] = file


def _different(file: Path, what: str, other: Path) -> UserError:
    return UserError(f"{file}: {what} is not the same here as in {other}: give only one of the two")


def _identity(e: Evaluation) -> str:
    return f"{e.method} (trained on {e.trained_on}, {e.steps} steps, seed {e.seed}, commit {e.commit}) on '{e.data}'"
