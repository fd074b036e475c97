"""One MLflow run per run folder, across kills and server outages."""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import mlflow
import pytest
from mlflow import MlflowClient

from rfpp.errors import UserError
from rfpp.training.run import locked
from rfpp.training.tracking.__main__ import main as send
from rfpp.training.tracking.journal import Journal, records
from rfpp.training.tracking.mlflow_logger import MlflowLogger
from rfpp.training.tracking.run_logger import RunLogger


@pytest.fixture(scope="module")
def empty_database(tmp_path_factory):
    """MLflow takes seconds to create its tables."""
    path = tmp_path_factory.mktemp("database") / "mlflow.db"
    MlflowClient(f"sqlite:///{path}").search_experiments()
    return path


@pytest.fixture
def store(tmp_path, empty_database):
    shutil.copy(empty_database, tmp_path / "mlflow.db")
    return tmp_path


def logger(folder, uri=None, run="run", patience=60.0, sweep=""):
    return MlflowLogger("rfpp", run, folder / run, folder, uri, patience, sweep)


def history(folder, run_id, name, uri=None):
    client = MlflowClient(uri or f"sqlite:///{folder}/mlflow.db")
    return [(m.step, m.value) for m in client.get_metric_history(run_id, name)]


def runs(folder):
    client = MlflowClient(f"sqlite:///{folder}/mlflow.db")
    return client.search_runs([client.get_experiment_by_name("rfpp").experiment_id])


# A training that logs every step and resumes from its last checkpoint, saved every tenth step.
TRAINING = """
import sys, time
from pathlib import Path
from rfpp.training.tracking.mlflow_logger import MlflowLogger

folder = Path(sys.argv[1])
logger = MlflowLogger("rfpp", "run", folder / "run", folder, None, 60.0)
checkpoint = folder / "checkpoint"
start = int(checkpoint.read_text()) if checkpoint.exists() else 0
for step in range(start, int(sys.argv[2])):
    logger.log_metrics({"train/loss": 1 / (1 + step), "speed": time.time()}, step)
    if step % 10 == 9:
        logger.sync()
        checkpoint.write_text(str(step + 1))
    if step == 5:
        print(logger.run_id, flush=True)
    time.sleep(0.05)
logger.finalize("success")
"""


def test_a_killed_run_resumes_in_the_same_mlflow_run_without_gaps_or_repetitions(store):
    def train(until):
        return subprocess.Popen([sys.executable, "-c", TRAINING, str(store), str(until)], stdout=subprocess.PIPE)

    with train(100_000) as process:
        process.stdout.readline()  # MLflow has created the run
        time.sleep(3)  # and some of it is sent
        with locked(store / "run"):
            assert send([str(store / "run")]) == 0
        assert runs(store)[0].info.status == "RUNNING"
        process.send_signal(signal.SIGKILL)
    assert send([str(store / "run")]) == 0
    assert runs(store)[0].info.status == "KILLED"
    until = max(record["step"] for record, _ in records(store / "run/tracking/journal.jsonl") if "step" in record) + 10
    with train(until) as process:
        assert process.wait() == 0
    (run,) = runs(store)
    assert run.info.status == "FINISHED"
    assert history(store, run.info.run_id, "train/loss") == [(step, 1 / (1 + step)) for step in range(until)]
    assert [step for step, _ in history(store, run.info.run_id, "speed")] == list(range(until))


def test_the_runs_of_a_sweep_have_one_parent(store):
    for number in "01":
        tracked = logger(store, run=number, sweep=f"quickstart 2026/{number}")
        tracked.finalize("success" if tracked.run_id else "failed")
    logger(store, run="alone", sweep="quickstart 2026/").run_id  # noqa: B018 (creates it)
    parents = {run.info.run_name: run.data.tags.get("mlflow.parentRunId") for run in runs(store)}
    (parent,) = [run.info.run_id for run in runs(store) if run.info.run_name == "sweep quickstart 2026"]
    assert parents == {"0": parent, "1": parent, "alone": None, "sweep quickstart 2026": None}


def test_records_sent_twice_are_stored_once(store):
    first = logger(store)
    first.log_metrics({"a": 1.0, "not a number": float("nan")}, 0)
    first.log_hyperparams({"x": {"y": 1}})
    first.log_file(_png(store / "run" / "a.png"), "pictures")
    first.finalize("success")
    target = store / "run/tracking/run.json"
    target.write_text(json.dumps(json.loads(target.read_text()) | {"sent": 0}))  # not written yet

    assert send([str(store / "run")]) == 0
    (run,) = runs(store)
    client = MlflowClient(f"sqlite:///{store}/mlflow.db")
    assert history(store, run.info.run_id, "a") == [(0, 1.0)]
    assert len(client.get_metric_history(run.info.run_id, "not a number")) == 1
    assert [a.path for a in client.list_artifacts(run.info.run_id, "pictures")] == ["pictures/a.png"]
    assert run.data.params == {"x.y": "1"}


def test_a_lost_run_id_is_found_again(store):
    first = logger(store)
    first.log_metrics({"a": 0.0}, 2)
    first.finalize("success")
    target = store / "run/tracking/run.json"
    target.write_text(json.dumps(json.loads(target.read_text()) | {"run_id": None}))  # not written yet
    again = logger(store)
    again.log_metrics({"a": 1.0}, 3)
    again.finalize("success")
    (run,) = runs(store)
    assert run.data.metrics == {"a": 1.0}


class Server:
    """A real `mlflow server` on a port of its own."""

    def __init__(self, folder: Path):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.uri, self._folder = f"http://127.0.0.1:{self.port}", folder
        self._process = None

    def start(self):
        command = [
            sys.executable, "-m", "mlflow", "server", "--port", str(self.port), "--workers", "1",
            "--backend-store-uri", f"sqlite:///{self._folder}/server.db",
            "--artifacts-destination", str(self._folder / "served"),
        ]  # fmt: skip
        with open(self._folder / "server.log", "ab") as log:
            self._process = subprocess.Popen(
                command, stdout=log, stderr=log, cwd=self._folder, start_new_session=True,
                env={**os.environ, "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false"},
            )  # fmt: skip

    def stop(self):
        if self._process is not None:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
            self._process = None


@pytest.fixture
def server(tmp_path, empty_database):
    shutil.copy(empty_database, tmp_path / "server.db")
    server = Server(tmp_path)
    yield server
    server.stop()


@pytest.mark.filterwarnings("ignore:MLflow at")
def test_an_unreachable_server_receives_everything_later(server, tmp_path, capsys):
    away = logger(tmp_path, server.uri, patience=2.0)
    before = time.monotonic()
    away.log_metrics({"a": 0.0}, 0)
    assert time.monotonic() - before < 1  # logging does not wait
    assert away.run_id is None

    server.start()
    deadline = time.monotonic() + 120
    while away.run_id is None and time.monotonic() < deadline:
        time.sleep(0.2)
    run_id = away.run_id
    away.log_metrics({"a": 1.0}, 1)

    server.stop()
    away.log_metrics({"a": 2.0}, 2)
    away.log_file(_png(tmp_path / "run" / "a.png"), "pictures")
    away.finalize("success")
    assert f"python -m rfpp.training.tracking {tmp_path / 'run'}" in capsys.readouterr().out
    assert send([str(tmp_path / "run")]) == 1
    assert "error" in capsys.readouterr().err

    server.start()
    while send([str(tmp_path / "run")]) and time.monotonic() < deadline:
        time.sleep(1)
    assert history(tmp_path, run_id, "a", server.uri) == [(0, 0.0), (1, 1.0), (2, 2.0)]
    run = MlflowClient(server.uri).get_run(run_id)
    assert run.info.status == "FINISHED"
    assert list((tmp_path / "served").rglob("a.png"))


def test_a_refused_record_is_warned_of_and_the_rest_is_sent(store):
    tracked = logger(store)
    tracked.log_file(store / "run" / "deleted.png")
    tracked.log_metrics({"a": 1.0}, 0)
    with pytest.warns(UserWarning, match="refused artifact"):
        tracked.finalize("success")
    (run,) = runs(store)
    assert run.data.metrics == {"a": 1.0}


def test_the_data_set_is_an_input_of_the_run(store):
    tracked = logger(store)
    tracked._journal.append(
        "dataset", name="boxes", digest="0123456789" * 6, source="/data/boxes", counts={"scenes": 3}
    )
    tracked.finalize("success")
    (run,) = runs(store)
    (used,) = run.inputs.dataset_inputs
    assert (used.dataset.name, used.dataset.digest) == ("boxes", ("0123456789" * 6)[:36])
    assert mlflow.data.get_source(used).uri == "/data/boxes"


def test_a_journal_cut_short_loses_its_last_line_alone(tmp_path):
    path = tmp_path / "journal.jsonl"
    journal = Journal(path)
    journal.metrics({"a": 1.0}, 0)
    journal.metrics({"a": 2.0}, 1)
    journal.close()
    path.write_bytes(path.read_bytes()[:-7])
    again = Journal(path)
    again.metrics({"a": 1.0}, 0)
    again.metrics({"a": 2.0, "b": 3.0}, 1)
    assert [record["values"] for record, _ in records(path)] == [{"a": 1.0}, {"a": 2.0, "b": 3.0}]


def test_a_damaged_record_is_warned_of_and_omitted(tmp_path):
    path = tmp_path / "journal.jsonl"
    path.write_bytes(b'\0\0\0\n[1]\n{"kind": "tags", "values": {}}\n')
    with pytest.warns(UserWarning, match=f"{path}: damaged"):
        assert [record["kind"] for record, _ in records(path)] == ["tags"]


def test_a_damaged_run_file_is_one_clear_line(store):
    (store / "run/tracking").mkdir(parents=True)
    (store / "run/tracking/run.json").write_text("{")
    with pytest.raises(UserError, match=r"run\.json.*delete it"):
        logger(store).log_hyperparams({})


def _png(path):
    from PIL import Image

    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", (4, 4)).save(path)
    return path


def test_a_run_started_without_mlflow_resumes_with_it(store):
    first = RunLogger("run", store / "run")
    first.log_metrics({"loss": 2.0}, 0)
    first.log_hyperparams({"x": 1})
    first.finalize("success")
    again = logger(store)
    again.log_metrics({"loss": 1.0}, 1)
    again.finalize("success")
    (run,) = runs(store)
    assert history(store, run.info.run_id, "loss") == [(0, 2.0), (1, 1.0)]
    assert run.data.params == {"x": "1"}
