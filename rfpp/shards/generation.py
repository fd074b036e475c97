"""Generate a data set, resumable at any time.

Every sample is a pure function of its task and the settings (`rfpp.shards.recipe`): whoever makes it, on however many
workers or machines, in whatever order, gets the same bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from filelock import FileLock, Timeout

from rfpp.errors import MissingDependencyError, ShardError, UserError
from rfpp.reference.farm import RenderFarm
from rfpp.shards.checkpointed_shard import KeptJob, SampleFolder, UnfinishedShard
from rfpp.shards.index import load_index, to_json
from rfpp.shards.job import SceneTask
from rfpp.shards.manifest import MANIFEST_FILE, Manifest, manifest_json
from rfpp.shards.recipe import WHOLE, Recipe, Slice
from rfpp.shards.writer import write_json


def make(recipe: Recipe, farm: RenderFarm, progress: Callable[[int, int], None], part: Slice = WHOLE) -> None:
    """Generate the missing samples of one slice of a data set.

    Finished shards and samples are left alone. A failing scene is tried twice, then kept with its traceback among
    the unfinished, and the rest goes on.

    Args:
        progress: called with (scenes finished, scenes in all) of the slice, first with what is there already.

    Raises:
        ShardError: the folder holds data made with other settings, or scenes failed.
        MissingDependencyError: Blender or Embree is not installed.
        UserError: the disk is full, or another process is making this slice.
    """
    recipe.require_same_settings()
    with _alone(recipe, part):
        _make(recipe, farm, progress, part)


def _make(recipe: Recipe, farm: RenderFarm, progress: Callable[[int, int], None], part: Slice) -> None:
    shards = recipe.slice(part)
    unfinished = [
        UnfinishedShard.of(recipe, shard) for shard in shards if not shard.is_finished(recipe.root, recipe.fingerprint)
    ]
    missing = {shard.shard.file: {task.key for task in shard.missing()} for shard in unfinished}
    total = sum(len(shard.tasks) for shard in shards)
    done = total - sum(map(len, missing.values()))
    progress(done, total)
    for shard in unfinished:
        if not missing[shard.shard.file]:  # stopped between its last sample and its end
            shard.assemble()
    by_folder = {shard.folder.path: shard for shard in unfinished}
    failures: list[tuple[SceneTask, Exception, SampleFolder]] = []
    for (task, folder), error in farm.map(KeptJob(recipe.job), _work(unfinished, missing)):
        if isinstance(error, MissingDependencyError) or type(error) is UserError:
            raise error  # the scene is not to blame, and the next will do no better
        if error is not None:
            failures.append((task, error, folder))
            folder.write_failure(task.key, error)
            continue
        shard = by_folder[folder.path]
        missing[shard.shard.file].remove(task.key)
        done += 1
        progress(done, total)
        if not missing[shard.shard.file]:
            shard.assemble()
    if failures:
        task, error, folder = failures[0]
        raise ShardError(
            f"{len(failures)} of {total} scenes failed, first {task.key} ({type(error).__name__}: {error}); the others "
            f"are finished; tracebacks are in {folder.path.parent}; repeat one alone with action=reproduce "
            f"sample={task.key}, mend the cause and run the same command again"
        )


def merge(recipe: Recipe) -> Manifest:
    """Merge the finished shards of all slices into a data set by writing its manifest.

    Raises:
        ShardError: shards are missing, or were made with other settings.
        UserError: the disk is full.
    """
    recipe.require_same_settings()
    unfinished = [s.file for s in recipe.all_shards if not s.is_finished(recipe.root, recipe.fingerprint)]
    if unfinished:
        raise ShardError(
            f"{recipe.root}: {len(unfinished)} of {len(recipe.all_shards)} shards are not finished, first "
            f"{unfinished[0]}: make them (action=status says which), or copy them here from where they were made"
        )
    indices = {
        split: [load_index(recipe.root, shard.file) for shard in shards] for split, shards in recipe.shards.items()
    }
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
def _alone(recipe: Recipe, part: Slice) -> Iterator[None]:
    """Lock a slice for this process; the lock is released when the process ends."""
    path = recipe.root / f".slice-{part.index}-of-{part.count}.lock"
    try:
        with FileLock(path, blocking=False):
            try:
                yield
            finally:
                path.unlink(missing_ok=True)
    except Timeout:
        raise UserError(
            f"{recipe.root}: another process is making slice {part.index} of {part.count} there: wait for it, or end it"
        ) from None


def _work(unfinished: list[UnfinishedShard], missing: dict[str, set[str]]) -> Iterator[tuple[SceneTask, SampleFolder]]:
    for shard in unfinished:
        wanted = set(missing[shard.shard.file])
        yield from ((task, shard.folder) for task in shard.shard.tasks if task.key in wanted)
