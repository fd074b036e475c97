"""Base class of the loggers: writes everything to the run folder's journal."""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

from lightning.pytorch.loggers.logger import Logger
from lightning.pytorch.utilities import rank_zero_only

from rfpp.files import write_atomically
from rfpp.shards.manifest import Manifest
from rfpp.training.tracking.description import code_changes, flattened, machine_tags
from rfpp.training.tracking.journal import JOURNAL, Journal


class RunLogger(Logger):
    """Writes to the run folder's journal; resumed runs append to it.

    Args:
        run_name: in tables.
        run_dir: the run's folder.
    """

    def __init__(self, run_name: str, run_dir: str | Path):
        super().__init__()
        self.run_dir, self._run_name = Path(run_dir), run_name
        self._statuses = {"success": "FINISHED", "failed": "FAILED"}  # Lightning's words and MLflow's

    @cached_property
    def _journal(self) -> Journal:
        """Created on rank 0 at the first access; a run that fails before then leaves no journal."""
        return self._begun()

    def _begun(self) -> Journal:
        journal = Journal(self.run_dir / JOURNAL)
        journal.append("status", value="RUNNING")
        return journal

    @abstractmethod
    def _end(self) -> None:
        """Called when the journal is complete."""

    @property
    @abstractmethod
    def kept(self) -> str:
        """Where metrics are stored, for the start summary on rank 0."""

    @property
    @abstractmethod
    def whereabouts(self) -> str:
        """Where to view the run, for the end summary on rank 0."""

    @property
    def name(self) -> str:
        return self._run_name

    @property
    def version(self) -> str | None:
        return self.run_id

    @property
    def run_id(self) -> str | None:
        """MLflow's, if it is known."""
        return None

    @property
    def tracking_uri(self) -> str | None:
        """Of MLflow's server or store, if there is one."""
        return None

    @property
    def registered_model(self) -> str | None:
        """`models:/<name>/<version>`, once MLflow has made the version."""
        return None

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
        """Note that the run is stopped early and will be resumed in this folder."""
        self._statuses["failed"] = "KILLED"

    @rank_zero_only
    def finalize(self, status: str) -> None:
        if "_journal" not in self.__dict__:
            return  # nothing has been logged
        self._journal.append("status", value=self._statuses[status])
        self._journal.sync()
        self._end()

    def _inside(self, path: Path) -> str:
        """The path relative to the run folder, which may be moved."""
        return str(Path(path).absolute().relative_to(self.run_dir.absolute()))
