"""Logger of MLflow runs: one MLflow run per run folder, across restarts and server outages."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from lightning.pytorch.utilities import rank_zero_only

from rfpp.training.tracking.journal import Journal
from rfpp.training.tracking.mlflow_run import Target
from rfpp.training.tracking.run_logger import RunLogger
from rfpp.training.tracking.sending import TARGET, Sender

#: A scheduler that tells a process to stop gives it half a minute or so.
SECONDS_BEFORE_A_KILL = 5.0


class RunFolderLogger(RunLogger):
    """Writes to the run folder's journal, which a thread sends to MLflow.

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
        super().__init__(run_name, run_dir)
        self.patience = patience
        self._new_target = partial(Target.new, folder, tracking_uri, experiment_name, run_name, parent)

    def _begun(self) -> Journal:
        target = self.run_dir / "tracking" / TARGET
        if not target.exists():
            self._new_target().write(target)
        journal = super()._begun()
        self._sends = Sender(self.run_dir)
        self._sends.start()
        return journal

    @property
    def _sender(self) -> Sender | None:
        """None on other ranks."""
        return self._sends if rank_zero_only.rank == 0 and self._journal else None

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

    @property
    def kept(self) -> str:
        return f"tracked in {self.tracking_uri}"

    @property
    def whereabouts(self) -> str:
        run = f"MLflow   run {self.run_id or 'not made yet'}"
        if self.tracking_uri.startswith("sqlite:"):
            return f"{run}, mlflow ui --backend-store-uri {self.tracking_uri}"
        return f"{run} at {self.tracking_uri}"

    def will_go_on(self) -> None:
        """Note that the run is stopped early; the rest of the journal is sent when it resumes, instead of now."""
        super().will_go_on()
        self.patience = min(self.patience, SECONDS_BEFORE_A_KILL)

    def _end(self) -> None:
        if not self._sends.close(self.patience):
            command = f"python -m rfpp.training.tracking {self.run_dir}"
            print(f"MLflow at {self.tracking_uri} lacks the end of this run: send it with {command}")
