"""Ctrl-C while processes are being started."""

import signal
import threading

import pytest

from rfpp.child_signals import unheard_by_children


def test_control_c_waits_for_the_end_though_another_thread_takes_it():
    begun, reached = threading.Event(), []

    def take() -> None:
        begun.wait()
        signal.raise_signal(signal.SIGINT)

    def start_processes() -> None:
        with unheard_by_children():
            begun.set()
            other.join()
            reached.append("the end")

    other = threading.Thread(target=take)  # begun before: it does not share the mask
    other.start()
    with pytest.raises(KeyboardInterrupt):
        start_processes()
    assert reached == ["the end"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])
