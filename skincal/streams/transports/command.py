"""The output of a program."""

from __future__ import annotations

import contextlib
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from skincal.child_environment import operator_environment
from skincal.devices.family import Command
from skincal.devices.link import FailureKind, Link, LinkError
from skincal.streams.transports import Opening

SHOWN_STDERR_MAX_CHARS = 300
"""Characters shown of what a command printed to stderr last."""
MAX_QUEUED_READS = 64
"""Reads that wait; a command that prints faster waits itself."""
CANCEL_CHECK_PERIOD_S = 0.1
"""s between two checks whether anybody still waits for the command."""
COMMAND_END_TIMEOUT_S = 1.0
"""s that a command has to end after the signal."""


def open_transport(opening: Opening) -> Link:
    """Start the command of the address, without a shell."""
    command = opening.address.command
    assert command is not None
    begun_s = time.monotonic()
    try:
        link = CommandLink(opening.address.label, command, opening.is_cancelled)
    except LinkError:
        # A driver costs a process for each attempt: not ten a second.
        time.sleep(max(0.0, begun_s + COMMAND_END_TIMEOUT_S - time.monotonic()) if command.is_driver else 0.0)
        raise
    if not command.is_driver or link.has_received:
        return link
    link.close()
    sentence = f"{opening.address.label}: the sensor sends nothing; check its power and its address."
    raise LinkError(FailureKind.ABSENT, sentence)


_OWN_PROCESS_GROUP: dict[str, Any] = (
    # Without a console of its own a command in a program without one would open a window.
    {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW}
    if sys.platform == "win32"
    else {"start_new_session": True}
)
"""Ctrl-C in a terminal then reaches only this program, which ends the command with everything that it started."""


def end_tree(pid: int) -> None:
    """End a process of Windows and its children, which no signal reaches. Raises OSError: there is no such tool."""
    # By its full path, so that no program of the working folder is run.
    tool = Path(os.environ.get("SYSTEMROOT", r"C:\Windows")) / "System32" / "taskkill.exe"
    with contextlib.suppress(subprocess.TimeoutExpired):
        subprocess.run(
            [str(tool), "/F", "/T", "/PID", str(pid)], capture_output=True, check=False, timeout=COMMAND_END_TIMEOUT_S
        )


class CommandLink:
    """The output of a command, which runs as long as the link is open.

    The constructor waits for the first bytes, as long as the command allows.
    """

    tried: tuple[int, ...] = ()

    def __init__(self, address: str, command: Command, is_cancelled: Callable[[], bool] = lambda: False) -> None:
        self._address, self._who = address, f"{address}: {command.who}"
        self._kind_of_end = FailureKind.VANISHED if command.is_driver else FailureKind.ENDED
        stdin = subprocess.PIPE if command.has_input else subprocess.DEVNULL
        # Without this, Python buffers the lines of a script in blocks of 8 kB, since its output is a pipe.
        environment = {**(os.environ if command.is_driver else operator_environment()), "PYTHONUNBUFFERED": "1"}
        streams: dict[str, Any] = {"stdin": stdin, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        try:
            self._process = subprocess.Popen(command.words, bufsize=0, env=environment, **_OWN_PROCESS_GROUP, **streams)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise LinkError(FailureKind.ADDRESS, f"{address}: cannot be started: {reason}; check the command.") from error
        self._reads: queue.Queue[bytes] = queue.Queue(MAX_QUEUED_READS)
        self._error_text = b""
        self._threads = [threading.Thread(target=work, daemon=True) for work in (self._read_output, self._read_errors)]
        for thread in self._threads:
            thread.start()
        self._early = b""
        try:
            until_s = time.monotonic() + command.first_bytes_max_s
            while not (self._early or is_cancelled()) and (left_s := until_s - time.monotonic()) > 0:
                self._early = self.read(min(left_s, CANCEL_CHECK_PERIOD_S))
        except LinkError as failure:
            self.close()
            raise LinkError(self._kind_of_end if command.is_driver else FailureKind.ADDRESS, str(failure)) from failure

    def _read_output(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as stream:
            while data := stream.read(1 << 16):
                self._reads.put(data)
        self._reads.put(b"")

    def _read_errors(self) -> None:
        assert self._process.stderr is not None
        with self._process.stderr as stream:
            while data := stream.read(1 << 12):
                self._error_text = (self._error_text + data)[-SHOWN_STDERR_MAX_CHARS * 10 :]

    @property
    def has_received(self) -> bool:
        """Whether the first bytes have come."""
        return bool(self._early)

    def read(self, timeout_s: float) -> bytes:
        if self._early:
            early, self._early = self._early, b""
            return early
        try:
            data = self._reads.get(timeout=timeout_s)
        except queue.Empty:
            return b""
        if not data:
            self._reads.put(b"")
            raise LinkError(self._kind_of_end, self._end_sentence())
        return data

    def _end_sentence(self) -> str:
        try:
            code = self._process.wait(COMMAND_END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            return f"{self._who} has closed its output."
        self._threads[1].join(COMMAND_END_TIMEOUT_S)
        if code == 0:
            return f"{self._who} has ended."
        lines = self._error_text.decode("utf-8", "replace").strip().splitlines()
        why = f": {lines[-1][-SHOWN_STDERR_MAX_CHARS:].rstrip('.')}" if lines else ""
        return f"{self._who} has ended with code {code}{why}."

    def write(self, data: bytes) -> None:
        """Do nothing: a command accepts no input."""

    def close(self) -> None:
        """End the command and everything that it started."""
        self._end(signal.SIGTERM)
        until_s = time.monotonic() + COMMAND_END_TIMEOUT_S
        while (self._is_running() or self._threads[0].is_alive()) and time.monotonic() < until_s:
            # The thread may wait for room.
            with contextlib.suppress(queue.Empty):
                self._reads.get(timeout=0.02)
        if self._is_running():
            self._end(getattr(signal, "SIGKILL", signal.SIGTERM))
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(COMMAND_END_TIMEOUT_S)
        if self._process.stdin is not None:
            self._process.stdin.close()

    def _is_running(self) -> bool:
        """Check whether the command, or anything that it started, still runs."""
        if self._process.poll() is None or sys.platform == "win32":
            return self._process.poll() is None
        try:
            os.killpg(self._process.pid, 0)
        except OSError:
            return False
        return True

    def _end(self, number: int) -> None:
        with contextlib.suppress(OSError):
            if sys.platform != "win32":
                os.killpg(self._process.pid, number)
            elif self._process.poll() is None:
                end_tree(self._process.pid)
                self._process.terminate()
