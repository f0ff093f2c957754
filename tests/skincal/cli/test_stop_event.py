"""The event that Ctrl-C sets."""

import signal
import sys
import threading

import pytest

from skincal.cli.record import stopping


def wait_interrupted_at(event, step):
    """Wait for the event, with a signal before the given line of the standard library's or our own `wait`."""
    left = step

    def trace(frame, kind, _value):
        nonlocal left
        if "threading.py" not in frame.f_code.co_filename and "stop_event.py" not in frame.f_code.co_filename:
            return None
        if kind == "line":
            left -= 1
            if left == 0:
                sys.settrace(None)
                signal.raise_signal(signal.SIGTERM)
        return trace

    sys.settrace(trace)
    try:
        return event.wait(0.05)
    finally:
        sys.settrace(None)


@pytest.mark.timeout(60)
@pytest.mark.parametrize("step", range(1, 9))
def test_a_signal_at_any_line_of_a_wait_sets_the_event(step):
    with stopping() as stop:
        wait_interrupted_at(stop, step)
        if not stop.is_set():  # fewer lines than steps
            signal.raise_signal(signal.SIGTERM)
        assert stop.is_set()
        assert stop.wait(0.0)


def test_every_thread_that_waits_wakes():
    with stopping() as stop:
        woken = []
        threads = [threading.Thread(target=lambda: woken.append(stop.wait(30.0))) for _ in range(3)]
        for thread in threads:
            thread.start()
        stop.set()
        for thread in threads:
            thread.join(30.0)
        assert woken == [True, True, True]
        assert stop.wait()


def test_a_wait_without_a_signal_ends_after_its_time():
    with stopping() as stop:
        assert not stop.wait(0.01)
