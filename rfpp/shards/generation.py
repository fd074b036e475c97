"""Generate a data set, resumable at any time.

Every sample is a pure function of its task and the settings (`rfpp.shards.recipe`), whatever the order, the number of
workers and the machine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from filelock import FileLock, Timeout

from rfpp.errors import MissingDependencyError, ShardError, UserError
from rfpp.reference.farm import RenderFarm
from rfpp.shards.checkpointed_shard import FOLDER, CheckpointedJob, UnfinishedShard
from rfpp.shards.index import to_json
from rfpp.shards.manifest import MANIFEST_FILE, Manifest, manifest_json
from rfpp.shards.recipe import WHOLE, Recipe, Slice
from rfpp.shards.writer import write_json


def make(recipe: Recipe, farm: RenderFarm, progress: Callable[[int, int], None], part: Slice = WHOLE) -> None:
    """Generate the missing samples of one slice of a data set.

    Finished shards and samples are left alone. A failing scene is tried twice and recorded with its traceback; the
    other scenes are still generated.

    Raises:
        ShardError: If the folder holds data of other settings, or scenes failed.
        MissingDependencyError: If Blender or Embree is not installed.
        UserError: If the disk is full, or another process is generating this slice.
    """
    recipe.require_same_settings()
    with _locked(recipe, part):
        _make(recipe, farm, progress, part)


def _make(recipe: Recipe, farm: RenderFarm, progress: Callable[[int, int], None], part: Slice) -> None:
    shards = recipe.slice(part)
    total = sum(len(shard.tasks) for shard in shards)
    unfinished = [UnfinishedShard(recipe, s) for s in shards if not s.finished(recipe.root, recipe.fingerprint)]
    tasks = {shard.folder: shard.missing() for shard in unfinished}
    shard_of = {shard.folder: shard for shard in unfinished}
    waiting = {folder: {task.key for task in missing} for folder, missing in tasks.items()}
    done = total - sum(map(len, waiting.values()))
    progress(done, total)
    for folder, keys in waiting.items():
        if not keys:  # the run stopped between the shard's last sample and its assembly
            shard_of[folder].assemble()
    failures: list[tuple[str, Exception]] = []
    work = ((task, folder) for folder, missing in tasks.items() for task in missing)
    for (task, folder), error in farm.map(CheckpointedJob(recipe.job), work):
        if isinstance(error, MissingDependencyError) or type(error) is UserError:
            raise error  # not the scene's fault; every other scene would fail as well
        if error is not None:
            failures.append((task.key, error))
            folder.write_failure(task.key, error)
            continue
        waiting[folder].remove(task.key)
        done += 1
        progress(done, total)
        if not waiting[folder]:
            shard_of[folder].assemble()
    if failures:
        key, error = failures[0]
        raise ShardError(
            f"{len(failures)} of {total} scenes failed, first {key} ({type(error).__name__}: {error}); the others are "
            f"finished; tracebacks are in {recipe.root / FOLDER}; repeat one alone with action=reproduce sample={key}, "
            "fix the cause and run the same command again"
        )


def merge(recipe: Recipe) -> Manifest:
    """Merge the finished shards of all slices into a data set by writing its manifest.

    Raises:
        ShardError: If shards are missing or have other settings.
    """
    recipe.require_same_settings()
    found = {shard.file: shard.finished(recipe.root, recipe.fingerprint) for shard in recipe.all_shards}
    if unfinished := [file for file, index in found.items() if index is None]:
        raise ShardError(
            f"{recipe.root}: {len(unfinished)} of {len(found)} shards are not finished, first {unfinished[0]}: "
            "generate them (action=status lists them), or copy them here"
        )
    indices = {split: [found[shard.file] for shard in shards] for split, shards in recipe.shards.items()}
    content = manifest_json(recipe.name, recipe.settings, recipe.views, indices)
    path = recipe.root / MANIFEST_FILE
    if not path.exists() or path.read_bytes() != to_json(content):
        write_json(path, content)
    return Manifest.load(recipe.root)


def generate(recipe: Recipe, farm: RenderFarm, progress: Callable[[int, int], None]) -> Manifest:
    """Generate the missing samples of a data set and write its manifest. Raises like `make`."""
    make(recipe, farm, progress)
    return merge(recipe)


@contextmanager
def _locked(recipe: Recipe, part: Slice) -> Iterator[None]:
    """Lock a slice for this process; the lock is released when the process exits."""
    path = recipe.root / f".slice-{part.index}-of-{part.count}.lock"
    try:
        with FileLock(path, blocking=False):
            try:
                yield
            finally:
                path.unlink(missing_ok=True)
    except Timeout:
        raise UserError(
            f"{recipe.root}: another process is generating slice {part.index} of {part.count}: wait for it, or stop it"
        ) from None
