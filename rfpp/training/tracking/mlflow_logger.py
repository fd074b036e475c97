"""Logger of MLflow runs: one MLflow run per run folder, across restarts and server outages."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from lightning.pytorch.utilities import rank_zero_only

from rfpp.training.tracking.journal import RUN_FILE, Journal
from rfpp.training.tracking.mlflow_run import MlflowRun
from rfpp.training.tracking.run_logger import RunLogger
from rfpp.training.tracking.sending import Sender

#: Patience after a stop signal: schedulers kill a process about half a minute after it.
SECONDS_BEFORE_A_KILL = 5.0


class MlflowLogger(RunLogger):
    """Writes to the run folder's journal, which a thread sends to MLflow.

    Resumed runs append to the same MLflow run, without gaps or repeated steps. Training does not wait for MLflow. What
    the server has not received at the end is sent by `python -m rfpp.training.tracking <run folder>`.

    Args:
        folder: Folder of the store if there is no server.
        patience: Seconds to wait for MLflow at the start, for the run's id, and at the end.
        sweep: Name of a sweep, a slash, and the run's number; without number if it is in no sweep.
    """

    def __init__(
        self,
        experiment_name: str,
        run_name: str,
        run_dir: str | Path,
        folder: str | Path,
        tracking_uri: str | None,
        patience: float,
        sweep: str = "",
    ):
        super().__init__(run_name, run_dir)
        self.patience = patience
        group, _, number = sweep.rpartition("/")
        names = (experiment_name, run_name, group if number else None)
        self._new_run = partial(MlflowRun.new, folder, tracking_uri, *names)

    def _begin(self) -> Journal:
        file = self.run_dir / RUN_FILE
        if not file.exists():
            self._new_run().write(file)
        journal = super()._begin()
        self._sends = Sender(self.run_dir)
        self._sends.start()
        return journal

    def _end(self) -> None:
        if not self._sends.close(self.patience):
            command = f"python -m rfpp.training.tracking {self.run_dir}"
            print(f"MLflow at {self.tracking_uri} lacks the end of this run: send it with {command}")

    @property
    def _sender(self) -> Sender | None:
        return self._sends if rank_zero_only.rank == 0 and self._journal else None

    @property
    def run_id(self) -> str | None:
        """MLflow's id of the run; None on other ranks, and until MLflow has been reached."""
        return self._sender and self._sender.run_id(self.patience)

    @property
    def tracking_uri(self) -> str | None:
        """URI of the server or store; None on other ranks."""
        return self._sender and self._sender.mlflow_run.tracking_uri

    @property
    def location(self) -> str:
        model = f", model {self._sender.registered}" if self._sender.registered else ""
        return f"MLflow run {self.run_id or 'not created yet'} in {self.tracking_uri}{model}"

    @rank_zero_only
    def sync(self) -> None:
        self._journal.sync()

    def mark_stopped(self) -> None:
        super().mark_stopped()
        self.patience = min(self.patience, SECONDS_BEFORE_A_KILL)
