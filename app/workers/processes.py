"""A process for work that would hold the window even from a thread: the calculation of a rig's errors keeps Python's lock.

It starts when it is first asked for something and ends with the window. No Qt here: the process imports this module, too.
"""

from __future__ import annotations

import logging
import os
import signal
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from multiprocessing.connection import Connection
    from multiprocessing.process import BaseProcess

LOG = logging.getLogger(__name__)
NICE = 5
"""The process stands back behind the window, which waits for a hand."""
STOP_S = 0.7
"""s. Closing waits this long for the end of a process that was killed. It keeps nothing that could be lost."""


class ProcessLostError(Exception):
    """The process ended while it was asked, and so did the one in its place; or it was closed."""


class ProcessService:
    """One process, asked from any thread; a pool of one, since the window's machine has little to spare.

    Not `concurrent.futures`: where a worker of its pool is killed while a request is on its way, closing the pool hangs for
    ever with Python 3.11.2 (docs/decisions/work-beside-the-window.md).
    """

    def __init__(self) -> None:
        self._asking = threading.Lock()
        """Held while the process is asked: one thing at a time."""
        self._starting = threading.Lock()
        self._process: BaseProcess | None = None
        self._connection: Connection[Any, Any] | None = None
        self._ticket = 0
        self._newest: Any = None
        """The newest ticket in shared memory, once there is a process."""
        self._closed = False

    @property
    def pid(self) -> int | None:
        """Of the process; None while none was started."""
        return None if self._process is None else self._process.pid

    def ticket(self) -> int:
        """Return a number for the next request; work on requests with earlier ones is no longer wanted."""
        self._ticket += 1
        if self._newest is not None:
            self._newest.value = self._ticket
        return self._ticket

    def ask(self, ticket: int, work: Callable[..., Any], *arguments: Any) -> Any:
        """Return what `work(*arguments, wanted)` returns in the process; blocks, so call it in a thread.

        Where the process ends meanwhile another takes its place, and is asked the same once. It knows nothing of what the first
        was asked before.

        Parameters
        ----------
        ticket : from `ticket`; `wanted` is a function that returns whether it is the newest
        work : a function of a module, which the process imports; raises whatever it raises there

        Raises
        ------
        ProcessLostError
            The second process ended, too, or the service is closed.
        """
        with self._asking:
            for last in (False, True):
                try:
                    connection = self._connection or self._start()
                    connection.send((ticket, work, arguments))
                    result, error = connection.recv()
                except (EOFError, OSError) as lost:
                    code = self._bury()
                    if last or self._closed:
                        raise ProcessLostError(f"its process ended (code {code})") from lost
                    LOG.warning("a process ended (code %s) while it was asked; another takes its place", code)
                    continue
                if error is not None:
                    raise error
                return result
        raise AssertionError

    def close(self) -> None:
        """End the process, by force, and start none any more; who waits for an answer gets a ProcessLostError."""
        with self._starting:
            self._closed = True
            process = self._process
        if process is not None:
            process.kill()
            process.join(STOP_S)

    def _start(self) -> Connection[Any, Any]:
        """Start the process; `multiprocessing` is imported only now, in the asking thread."""
        from multiprocessing import get_context

        context = get_context("spawn")
        # Nothing that lies in the working folder is run.
        os.environ["PYTHONSAFEPATH"] = "1"
        self._newest = newest = context.RawValue("q", 0)
        newest.value = self._ticket
        connection, its_end = context.Pipe()
        with self._starting:
            if self._closed:
                raise ProcessLostError("it is closed")
            self._process = process = context.Process(target=serve, args=(its_end, newest), name="skincal-heavy", daemon=True)
            process.start()
        its_end.close()
        self._connection = connection
        return connection

    def _bury(self) -> int | None:
        """Forget a process that ended; return its exit code."""
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()
        process = self._process
        if process is None:
            return None
        process.join(STOP_S)
        return process.exitcode


def serve(connection: Connection[Any, Any], newest: Any) -> None:
    """Do what comes, in the process, until the window's end of the connection is closed, however the window ended.

    Parameters
    ----------
    newest : shared memory whose `value` is the newest ticket
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C in a terminal is for the window, which closes this
    if hasattr(os, "nice"):
        os.nice(NICE)
    while True:
        try:
            ticket, work, arguments = connection.recv()
        except (EOFError, OSError):
            return
        try:
            answer = work(*arguments, lambda ticket=ticket: newest.value == ticket), None
        except Exception as error:  # noqa: BLE001 - it is raised where the answer is waited for
            answer = None, error
        try:
            connection.send(answer)
        except OSError:
            return
