"""A real Slurm of this machine alone, started by root in a folder of its own: munge, controller, node daemons."""

from __future__ import annotations

import os
import re
import shutil
import signal
import socket
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

import psutil

_SETTINGS = """
ClusterName=tests
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={port}
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket,cred_expire=5
CommunicationParameters=NoCtldInAddrAny,NoInAddrAny
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
MpiDefault=none
ReturnToService=2
MailProg=/bin/true
SchedulerParameters=sched_interval=2,bf_interval=2,requeue_delay=2,batch_sched_delay=0
StateSaveLocation={folder}/state
MinJobAge=86400
SlurmctldPidFile={folder}/slurmctld.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdSpoolDir={folder}/spool-%n
SlurmdPidFile={folder}/slurmd-%n.pid
SlurmdLogFile={folder}/slurmd-%n.log
{nodes}
PartitionName=debug Nodes=ALL Default=YES State=UP
"""

#: States of a job that has not ended.
UNDER_WAY = {"PENDING", "RUNNING", "COMPLETING", "CONFIGURING", "SUSPENDED"}


@dataclass
class SlurmCluster:
    """Attributes:
    folder: of configuration, state and logs.
    nodes: how many nodes this machine plays.
    """

    folder: Path
    nodes: int = 1

    def start(self) -> None:
        ports = free_ports(self.nodes + 1)
        first_line = subprocess.run(["slurmd", "-C"], capture_output=True, text=True, check=True).stdout.splitlines()[0]
        hardware = re.sub(r"NodeName=\S+ ", "", first_line)
        host = socket.gethostname().split(".")[0]
        nodes = [
            f"NodeName=n{i} NodeHostname={host} NodeAddr=127.0.0.1 Port={port} State=UNKNOWN {hardware}"
            for i, port in enumerate(ports[1:])
        ]
        settings = _SETTINGS.format(host=host, port=ports[0], folder=self.folder, nodes="\n".join(nodes))
        (self.folder / "slurm.conf").write_text(settings)
        (self.folder / "state").mkdir()
        os.environ["SLURM_CONF"] = str(self.folder / "slurm.conf")
        files = {"key-file": "munge.key", "socket": "munge.socket", "pid-file": "munged.pid", "log-file": "munged.log"}
        (self.folder / "munge.key").write_bytes(os.urandom(128))
        (self.folder / "munge.key").chmod(0o400)
        places = [f"--{option}={self.folder / name}" for option, name in {**files, "seed-file": "munge.seed"}.items()]
        self._run("munged", "--force", *places)
        self._run("slurmctld")
        for i in range(self.nodes):
            self._run("slurmd", "-N", f"n{i}")
        self._wait_for_nodes()

    def stop(self) -> None:
        """Ends all daemons and whatever jobs they run."""
        subprocess.run(["scancel", "--user=root"], capture_output=True, timeout=20, check=False)
        for pid_file in sorted(self.folder.glob("*.pid"), reverse=True):
            try:
                os.kill(int(pid_file.read_text()), signal.SIGTERM)
            except (ProcessLookupError, ValueError):
                continue
        os.environ.pop("SLURM_CONF", None)

    def submit(self, *arguments: str, cwd: Path) -> str:
        """`sbatch` these arguments; returns the job's number."""
        run = subprocess.run(["sbatch", "--parsable", *arguments], cwd=cwd, capture_output=True, text=True, check=False)
        assert run.returncode == 0, run.stderr
        return run.stdout.strip()

    def signal(self, job: str, name: str) -> None:
        """Send a signal to every task of a job, as Slurm does before a time limit."""
        subprocess.run(["scancel", f"--signal={name}", job], timeout=30, check=True)

    def cancel(self, job: str) -> None:
        """End a job as its owner does."""
        subprocess.run(["scancel", job], timeout=30, check=True)

    def tasks(self, job: str) -> list[psutil.Process]:
        """The processes that Slurm's daemons have started for a job's tasks, in their order."""
        found = {}
        for process in psutil.process_iter():
            try:
                variables = process.environ()
                if variables.get("SLURM_JOB_ID") == job and process.parent().name().startswith("slurmstepd"):
                    found[int(variables["SLURM_PROCID"])] = process
            except (psutil.Error, KeyError, AttributeError):  # the batch script is no task; others have ended
                continue
        return [found[rank] for rank in sorted(found)]

    def wait(self, job: str, timeout: float = 600) -> list[str]:
        """Wait until all tasks of a job have ended; returns their states."""
        deadline = time.monotonic() + timeout
        states: list[str] = []
        while time.monotonic() < deadline:
            states = self.states(job)
            if states and not set(states) & UNDER_WAY:
                return states
            time.sleep(0.3)
        raise TimeoutError(f"job {job} is {states} after {timeout} s; see {self.folder}/*.log")

    def wait_for(self, job: str, state: str, timeout: float = 300) -> None:
        """Wait until a job that has been running is in this state."""
        deadline = time.monotonic() + timeout
        ran = False
        while time.monotonic() < deadline:
            states = self.states(job)
            if ran and states == [state]:
                return
            ran |= states == ["RUNNING"]
            time.sleep(0.3)
        raise TimeoutError(f"job {job} is {states} after {timeout} s; see {self.folder}/*.log")

    def states(self, job: str) -> list[str]:
        """Return the states of the tasks of a job."""
        shown = subprocess.run(
            ["scontrol", "show", "job", job], capture_output=True, text=True, timeout=30, check=False
        ).stdout
        return re.findall(r"JobState=(\w+)", shown)

    def _run(self, *command: str) -> None:
        run = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
        assert run.returncode == 0, f"{command[0]}: {run.stdout}{run.stderr}"

    def _wait_for_nodes(self) -> None:
        deadline = time.monotonic() + 30
        while time.monotonic() < deadline:
            shown = subprocess.run(
                ["sinfo", "-h", "-N", "-o", "%t"], capture_output=True, text=True, timeout=10, check=False
            )
            if shown.stdout.split() == ["idle"] * self.nodes:
                return
            time.sleep(0.2)
        raise TimeoutError(f"Slurm's nodes did not come up: see {self.folder}/*.log")


def is_available() -> bool:
    """Return whether Slurm is installed and may be started."""
    return os.geteuid() == 0 and all(map(shutil.which, ("munged", "slurmctld", "slurmd", "sbatch", "srun")))


def free_ports(count: int) -> list[int]:
    """Ports that nothing listens on."""
    sockets = [socket.socket() for _ in range(count)]
    for each in sockets:
        each.bind(("127.0.0.1", 0))
    ports = [each.getsockname()[1] for each in sockets]
    for each in sockets:
        each.close()
    return ports
