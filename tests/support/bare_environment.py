"""An environment that has only what pyproject.toml's `dependencies` bring, out of one that has everything.

No virtual environment is made, which would take minutes and gigabytes: processes find no module, and no metadata, of
any other distribution.
"""

from __future__ import annotations

import inspect
import os
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Sequence
from importlib.metadata import Distribution, PackageNotFoundError, distributions, requires
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]

#: Runs when an interpreter starts, that of further processes too: what is hidden is not found, as if it were absent.
_SITE = """
import re, sys
from importlib.machinery import PathFinder

MODULES, DISTRIBUTIONS = {modules!r}, {distributions!r}

class Bare(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        return None if name.partition(".")[0] in MODULES else PathFinder.find_spec(name, path, target)

    @classmethod
    def find_distributions(cls, *args, **kwargs):
        for found in PathFinder.find_distributions(*args, **kwargs):
            if re.sub(r"[-_.]+", "-", found.metadata["Name"] or "").lower() not in DISTRIBUTIONS:
                yield found

sys.meta_path[sys.meta_path.index(PathFinder)] = Bare
"""


def requirements_with(*extras: str) -> list[str]:
    """Return the requirements of the project with these extras."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    return [*project["dependencies"], *(text for name in extras for text in project["optional-dependencies"][name])]


def closure(requirements: Sequence[str]) -> set[str]:
    """The normalized names of the installed distributions that these bring, and all that those need."""
    found: set[tuple[str, frozenset[str]]] = set()

    def add(text: str, extras: frozenset[str]) -> None:
        requirement = Requirement(text)
        if requirement.marker and not any(requirement.marker.evaluate({"extra": extra}) for extra in {"", *extras}):
            return
        item = (canonicalize_name(requirement.name), frozenset(requirement.extras))
        if item in found:
            return
        found.add(item)
        for needed in _requires(requirement.name):
            add(needed, item[1])

    for text in requirements:
        add(text, frozenset())
    return {name for name, _ in found}


def hidden(kept: set[str]) -> tuple[list[str], list[str]]:
    """Top-level modules, and distributions, of everything installed but `kept` and this project."""
    owners: dict[str, set[str]] = {}
    for distribution in distributions():
        name = canonicalize_name(distribution.metadata["Name"])
        for module in _top_level(distribution) if name != "rfpp" else ():
            owners.setdefault(module, set()).add(name)
    modules = sorted(module for module, names in owners.items() if not names & kept)
    return modules, sorted(set().union(*owners.values()) - kept)


def python(folder: Path, *arguments: str, extras: Sequence[str] = ()) -> subprocess.CompletedProcess[str]:
    """Run the interpreter in the source tree, in the bare environment with these extras.

    Args:
        folder: for the file that makes it bare.
    """
    modules, absent = hidden(closure(requirements_with(*extras)))
    folder.mkdir(exist_ok=True)
    (folder / "sitecustomize.py").write_text(_SITE.format(modules=set(modules), distributions=set(absent)))
    path = os.pathsep.join(map(str, (folder, ROOT)))
    environment = os.environ | {"PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
    return subprocess.run(
        [sys.executable, *arguments], cwd=ROOT, env=environment, capture_output=True, text=True, timeout=300
    )


def _requires(name: str) -> Iterator[str]:
    try:
        yield from requires(name) or ()
    except PackageNotFoundError:  # for another platform, or optional there
        return


def _top_level(distribution: Distribution) -> set[str]:
    """Names of its modules and packages."""
    names = {f.parts[0] if len(f.parts) > 1 else inspect.getmodulename(f.name) for f in distribution.files or ()}
    return {name for name in names if name and name.isidentifier()}
