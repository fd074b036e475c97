"""Go back to an earlier step of a run: move aside what came later, so that training continues as a new branch."""

from __future__ import annotations

import json
import os
import shutil
from itertools import count
from pathlib import Path

from rfpp.checkpoint.loading import read_checkpoint
from rfpp.files import write_atomically
from rfpp.training.checkpoint_files import find_defect, point_at, step_files, step_of
from rfpp.training.tracking.journal import JOURNAL, RUN_FILE, Record, records

#: Folder in a run's folder with what the run did after the steps that it went back to, numbered.
ASIDE = "rolled_back"
#: File in a run's folder with the omitted steps of the run: pairs of the first and the last.
OMITTED_STEPS = "omitted_steps.json"


def omitted_steps(run_dir: Path) -> list[range]:
    """Return the steps that a run omits."""
    file = run_dir / OMITTED_STEPS
    return [range(first, last + 1) for first, last in json.loads(file.read_bytes())] if file.exists() else []


def omit_steps(run_dir: Path, steps: range) -> Path | None:
    """Go back to the newest intact checkpoint before `steps`, and omit these steps from the run.

    Returns:
        The checkpoint; None: there is none, and nothing has changed.
    """
    earlier = (path for path in reversed(step_files(run_dir / "checkpoints")) if step_of(path) < steps[0])
    start = next((path for path in earlier if find_defect(path) is None), None)
    if start is not None:
        spans = [(span[0], span[-1]) for span in [*omitted_steps(run_dir), steps]]
        write_atomically(run_dir / OMITTED_STEPS, json.dumps(spans).encode())
        roll_back(run_dir, start)
    return start


def continues_job(run_dir: Path) -> bool:
    """Return True for a requeued Slurm job that has trained in this folder: it resumes, and does not go back again."""
    requeued, job = int(os.environ.get("SLURM_RESTART_COUNT", "0")), os.environ.get("SLURM_JOB_ID")
    tags = (record["values"] for record in _journal(run_dir) if record["kind"] == "tags") if requeued else ()
    return any(values.get("slurm_job_id") == job for values in tags)


def roll_back(run_dir: Path, start: Path | None) -> Path | None:
    """Move aside the files of a run that are later than `start`.

    Later checkpoints and the journal move to `rolled_back/<number>`. The branch begins with the metrics up to the step
    of `start`, and gets an MLflow run of its own. A best checkpoint of a later step is replaced by `start`. If it is
    interrupted, calling it again completes it.

    Args:
        start: Checkpoint to resume from; None: the beginning.

    Returns:
        The folder with the moved files; None if nothing was later.
    """
    step, start = (0, None) if start is None else (_step(start), start.resolve())
    checkpoints = run_dir / "checkpoints"
    best, last = checkpoints / "best.ckpt", checkpoints / "last.ckpt"
    later = [path for path in step_files(checkpoints) if step_of(path) > step]
    is_best_later = best.exists() and _step(best) > step
    metrics = [record for record in _journal(run_dir) if record["kind"] == "metrics"]
    if not (later or is_best_later or any(record["step"] >= step for record in metrics)):
        return None
    aside = next(folder for n in count(1) if not (folder := run_dir / ASIDE / str(n)).exists())
    (aside / "checkpoints").mkdir(parents=True)
    if start is not None and start.parent == checkpoints.resolve():
        point_at(start, last)
    else:
        last.unlink(missing_ok=True)
    if is_best_later:
        shutil.copy2(best, aside / "checkpoints")
        best.unlink() if start is None else write_atomically(best, start.read_bytes())
    for path in later:
        path.rename(aside / "checkpoints" / path.name)
    if (run_dir / JOURNAL).exists():
        shutil.copytree(run_dir / JOURNAL.parent, aside / JOURNAL.parent)
        (run_dir / RUN_FILE).unlink(missing_ok=True)
        kept = [record for record in metrics if record["step"] < step]  # of metrics, the first is 0
        lines = (json.dumps(record) + "\n" for record in [*kept, _origin(aside, step)])
        write_atomically(run_dir / JOURNAL, "".join(lines).encode())
    return aside


def _origin(aside: Path, step: int) -> Record:
    """Return the record of tags that lead from the branch to the run that it left."""
    file = aside / RUN_FILE
    left = json.loads(file.read_bytes())["run_id"] if file.exists() else None
    values = {"branch/step": str(step), "branch/left": str(aside), "branch/left_run": str(left)}
    return {"kind": "tags", "time": int((aside / JOURNAL).stat().st_mtime * 1000), "values": values}


def _journal(run_dir: Path) -> list[Record]:
    return [record for record, _ in records(run_dir / JOURNAL)] if (run_dir / JOURNAL).exists() else []


def _step(checkpoint: Path) -> int:
    return read_checkpoint(checkpoint, mmap=True)["global_step"]
