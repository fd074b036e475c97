import atexit
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from multiprocessing import active_children
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from rfpp.child_signals import blocked_in_children
from rfpp.errors import SceneError, UserError
from rfpp.reference.farm import RenderFarm
from rfpp.reference.worker import WorkerDeathError, WorkerHangError


def slow_square(x: int) -> int:
    time.sleep(0.05 if x % 3 == 0 else 0)
    return x * x


def wait_for(path: str) -> None:
    while path.startswith("/") and not Path(path).exists():
        time.sleep(0.01)


def affinity(_: int) -> set[int]:
    return os.sched_getaffinity(0)


def process_id(_: int) -> int:
    return os.getpid()


def fail_once(flag: str) -> str:
    if not Path(flag).exists():
        Path(flag).touch()
        raise ValueError("the first time fails")
    return "done"


def die_once(flag: str) -> str:
    if not Path(flag).exists():
        Path(flag).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "done"


def hang_once(flag: str) -> str:
    if not Path(flag).exists():
        Path(flag).touch()
        time.sleep(600)
    return "done"


def always_hang(_: int) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # as code in the middle of a C library
    time.sleep(600)


HOARD = []


def hoard(_: int) -> int:
    HOARD.append(bytearray(os.urandom(1)) * 30_000_000)
    return os.getpid()


def always_die(_: int) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def talk_at_the_end(folder: str) -> str:
    """The second item waits in a temporary folder, with last words as Blender has them."""
    if folder == "first":
        return folder
    atexit.register(lambda: os.write(2, b"last words"))
    with TemporaryDirectory(dir=folder):
        (Path(folder) / "waiting").touch()
        time.sleep(600)
    return "never"


def bad_scene(path: str) -> None:
    with Path(path).open("a") as file:
        file.write("tried\n")
    raise SceneError("the mesh has no faces")


class UnpicklableError(Exception):
    def __init__(self, a, b):
        super().__init__(f"{a} and {b}")


def raise_unpicklable(_: int) -> None:
    raise UnpicklableError("this", "that")


def test_every_item_has_its_result():
    with RenderFarm(2) as farm:
        assert sorted(farm.map(slow_square, range(20))) == [(x, x * x) for x in range(20)]


def test_a_slow_item_holds_up_nobody(tmp_path):
    flag = tmp_path / "flag"
    with RenderFarm(2) as farm:
        results = farm.map(wait_for, [str(flag), *"abcde"])
        order = [next(results)[0] for _ in range(5)]
        flag.touch()
        assert [*order, next(results)[0]] == [*"abcde", str(flag)]


def test_items_are_read_lazily_and_workers_serve_several_maps():
    with RenderFarm(1) as farm:
        first = dict(farm.map(process_id, range(3)))
        endless = farm.map(process_id, iter(int, 1))
        assert next(endless)[1] == first[0]
        endless.close()


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="no CPU pinning on this system")
def test_each_worker_is_pinned_to_its_own_cores_and_the_parent_is_not():
    before = os.sched_getaffinity(0)
    with RenderFarm(0) as farm:
        seen = {frozenset(cores) for _, cores in farm.map(affinity, range(4 * len(farm)))}
        assert len(farm) == len(before)
    assert all(len(cores) == 1 for cores in seen)
    assert os.sched_getaffinity(0) == before


def test_control_c_reaches_no_worker_not_even_one_that_is_being_started():
    before = set(active_children())

    def interrupt() -> None:
        while not (started := set(active_children()) - before):
            time.sleep(0.001)
        os.kill(started.pop().pid, signal.SIGINT)

    with RenderFarm(1) as farm, ThreadPoolExecutor(1) as thread:
        interrupted = thread.submit(interrupt)
        assert list(farm.map(slow_square, [2], attempts=1)) == [(2, 4)]
        interrupted.result()


def test_a_signal_to_another_thread_while_a_worker_starts_is_handled_afterwards(request):
    handled = []
    request.addfinalizer(partial(signal.signal, signal.SIGUSR1, signal.getsignal(signal.SIGUSR1)))
    signal.signal(signal.SIGUSR1, lambda *_: handled.append("once"))
    with ThreadPoolExecutor(1) as thread:
        another = thread.submit(threading.get_ident).result()
        with blocked_in_children([signal.SIGUSR1]):
            signal.pthread_kill(another, signal.SIGUSR1)
            time.sleep(0.1)
            assert handled == []
    assert handled == ["once"]


def test_workers_are_recycled():
    with RenderFarm(1, jobs_per_worker=2) as farm:
        ids = [pid for _, pid in farm.map(process_id, range(5))]
    assert len(set(ids)) == 3
    assert os.getpid() not in ids


def test_a_job_that_fails_once_is_tried_again(tmp_path):
    with RenderFarm(1) as farm:
        assert [r for _, r in farm.map(fail_once, [str(tmp_path / "flag")])] == ["done"]


def test_a_worker_that_is_killed_is_replaced_and_its_item_tried_again(tmp_path):
    with RenderFarm(1) as farm:
        assert [r for _, r in farm.map(die_once, [str(tmp_path / "flag")])] == ["done"]


def test_an_item_that_always_kills_its_worker_is_an_error_with_the_signal():
    with RenderFarm(1) as farm:
        [(_, result)] = farm.map(always_die, [0])
    assert isinstance(result, WorkerDeathError)
    assert "-9" in str(result)


def test_a_hanging_worker_is_replaced_and_its_item_tried_again(tmp_path):
    with RenderFarm(2, max_job_seconds=4.0) as farm:
        results = [r for _, r in farm.map(hang_once, [str(tmp_path / name) for name in "abc"])]
    assert results == ["done"] * 3


def test_an_item_that_always_hangs_is_an_error_and_the_others_go_on():
    with RenderFarm(1, max_job_seconds=4.0) as farm:
        [(_, result)] = farm.map(always_hang, [0])
        assert isinstance(result, WorkerHangError)
        assert "after 4 s" in str(result)
        assert [r for _, r in farm.map(slow_square, [1, 2])] == [1, 4]


def test_a_busy_worker_that_is_stopped_says_nothing_and_leaves_no_files(tmp_path, capfd):
    with RenderFarm(2) as farm:
        results = farm.map(talk_at_the_end, ["first", str(tmp_path)])
        assert next(results)[1] == "first"
        while not (tmp_path / "waiting").exists():
            time.sleep(0.05)
        results.close()
    assert [path.name for path in tmp_path.iterdir()] == ["waiting"]
    assert capfd.readouterr().err == ""


def test_a_worker_that_is_told_to_leave_twice_unwinds_once_and_in_bounded_time():
    program = """
import signal, time
from rfpp.reference import worker

worker._UNWINDING = 1
signal.signal(signal.SIGTERM, worker._leave)
try:
    print("busy", flush=True)
    time.sleep(60)
finally:
    time.sleep(60)  # as a lock that nobody gives back
"""
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "busy\n"
        for _ in range(2):
            process.terminate()
            time.sleep(0.2)
        assert process.wait(30) == -signal.SIGALRM


def test_a_worker_that_grows_is_replaced():
    with RenderFarm(1, max_growth_mb=50) as farm:
        ids = [pid for _, pid in farm.map(hoard, range(6))]
    assert [ids.count(pid) for pid in dict.fromkeys(ids)] == [3, 3]


def test_a_user_error_is_final_and_keeps_its_type(tmp_path):
    tries = tmp_path / "tries"
    with RenderFarm(1) as farm:
        [(_, result)] = farm.map(bad_scene, [str(tries)])
    assert isinstance(result, SceneError)
    assert str(result) == "the mesh has no faces"
    assert tries.read_text() == "tried\n"


def test_an_unpicklable_exception_arrives_with_its_message_and_traceback():
    with RenderFarm(1) as farm:
        [(_, result)] = farm.map(raise_unpicklable, [0])
    assert "this and that" in str(result)
    assert "raise_unpicklable" in result.__notes__[0]


def test_a_negative_worker_count_is_refused():
    with pytest.raises(UserError, match="workers is -1"):
        RenderFarm(-1)
