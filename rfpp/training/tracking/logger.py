"""The Lightning logger of a training run: one MLflow run, whatever happens to process, machine and server."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from lightning.pytorch.loggers.logger import Logger
from lightning.pytorch.utilities import rank_zero_only

from rfpp.scene.files import write_atomically
from rfpp.shards.manifest import Manifest
from rfpp.training.tracking.description import code_changes, flattened, machine_tags
from rfpp.training.tracking.journal import Journal
from rfpp.training.tracking.sending import JOURNAL, TARGET, Sender
from rfpp.training.tracking.store import Target

#: A scheduler that tells a process to stop gives it half a minute or so.
SECONDS_BEFORE_A_KILL = 5.0


class RunFolderLogger(Logger):
    """Writes into the run folder's journal, which a thread sends to MLflow.

    A run folder is one MLflow run: who trains on in it logs on in it, with no step missing and none twice. MLflow may
    be slow or away: training does not wait, and what MLflow lacks at the end is sent by
    `python -m rfpp.training.tracking <run folder>`.

    Args:
        experiment_name, run_name: in MLflow.
        run_dir: the run's folder.
        folder: of the store when there is no server.
        tracking_uri: of an MLflow server, or None.
        parent: name of the run that this one is part of; the first that names it makes it.
        patience: seconds to wait for MLflow at the start, for the run's id, and at the end.
    """

    def __init__(
        self,
        experiment_name: str,
        run_name: str,
        run_dir: str | Path,
        folder: str | Path,
        tracking_uri: str | None,
        parent: str | None,
        patience: float,
    ):
        super().__init__()
        self.run_dir, self.patience, self._run_name = Path(run_dir), patience, run_name
        self._statuses = {"success": "FINISHED", "failed": "FAILED"}  # Lightning's words and MLflow's
        self._new_target = partial(Target.new, folder, tracking_uri, experiment_name, run_name, parent)

    @cached_property
    def _begun(self) -> tuple[Journal, Sender]:
        """On rank 0 alone, by what is asked or logged first: a run that is refused before then is no run."""
        target = self.run_dir / "tracking" / TARGET
        if not target.exists():
            self._new_target().write(target)
        journal = Journal(self.run_dir / "tracking" / JOURNAL)
        journal.append("status", value="RUNNING")
        sender = Sender(self.run_dir)
        sender.start()
        return journal, sender

    @property
    def _journal(self) -> Journal:
        return self._begun[0]

    @property
    def _sender(self) -> Sender | None:
        return self._begun[1] if rank_zero_only.rank == 0 else None

    @property
    def name(self) -> str:
        return self._run_name

    @property
    def version(self) -> str | None:
        return self.run_id

    @property
    def run_id(self) -> str | None:
        """MLflow's; None on other ranks, and until MLflow has been reached."""
        return self._sender and self._sender.run_id(self.patience)

    @property
    def tracking_uri(self) -> str | None:
        """Of the server or store; None on other ranks."""
        return self._sender and self._sender.target.tracking_uri

    @property
    def registered_model(self) -> str | None:
        """`models:/<name>/<version>`, once MLflow has made the version."""
        return self._sender and self._sender.registered

    @rank_zero_only
    def log_metrics(self, metrics: Mapping[str, float], step: int | None = None) -> None:
        named = {re.sub(r"[^\w/. -]+", "", name, flags=re.ASCII): value for name, value in metrics.items()}
        named.pop("epoch", None)  # there are none, see GlobalBatches
        self._journal.metrics(named, step or 0)

    @rank_zero_only
    def log_hyperparams(self, params: dict[str, Any]) -> None:
        self._journal.parameters(flattened(params))

    @rank_zero_only
    def log_tags(self, tags: Mapping[str, str]) -> None:
        self._journal.append("tags", values=dict(tags))

    @rank_zero_only
    def log_file(self, path: Path, folder: str | None = None) -> None:
        """Log a file of the run folder as an artifact."""
        self._journal.append("artifact", path=self._inside(path), folder=folder)

    @rank_zero_only
    def register_model(self, name: str, checkpoint: Path) -> None:
        """Register a checkpoint of the run folder as the next version of a model."""
        self._journal.append("model", name=name, path=self._inside(checkpoint))

    @rank_zero_only
    def describe(self, config: dict[str, Any], config_file: Path, manifest: Manifest, tags: Mapping[str, str]) -> None:
        """Log what runs: config (as parameters and as a file), data set, code, machine, how often it was resumed."""
        self.log_hyperparams(config)
        self.log_tags({**tags, **machine_tags(), "resumed": str(self._journal.starts - 1)})
        self.log_file(config_file, "config")
        if changes := code_changes():
            self.log_file(write_atomically(self.run_dir / "code.diff", changes.encode()), "code")
        self._journal.append(
            "dataset", name=manifest.name, digest=manifest.hash, source=str(manifest.root), counts=manifest.counts
        )

    @rank_zero_only
    def sync(self) -> None:
        """See Journal.sync."""
        self._journal.sync()

    def will_go_on(self) -> None:
        """The run ends before its time, and this folder's next one sends what is left: waiting could take too long."""
        self._statuses["failed"], self.patience = "KILLED", min(self.patience, SECONDS_BEFORE_A_KILL)

    @rank_zero_only
    def finalize(self, status: str) -> None:
        if "_begun" not in self.__dict__:
            return  # nothing has been logged
        self._journal.append("status", value=self._statuses[status])
        self._journal.sync()
        if not self._sender.close(self.patience):
            command = f"python -m rfpp.training.tracking {self.run_dir}"
            print(f"MLflow at {self.tracking_uri} lacks the end of this run: send it with {command}")

    def _inside(self, path: Path) -> str:
        """Relative to the run folder, which may move."""
        return str(Path(path).absolute().relative_to(self.run_dir.absolute()))
