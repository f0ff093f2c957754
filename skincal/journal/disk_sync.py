"""Force the files of a journal onto the disk in a thread: a disk takes milliseconds, and the window must answer meanwhile."""

from __future__ import annotations

import contextlib
import os
import threading
from collections import deque
from typing import IO


class DiskSync:
    """Forces files onto the disk, one request after another, in a thread that exists while there is a request."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._descriptors: tuple[int, ...] = ()
        """Files of the next request; empty without one."""
        self._finished: deque[tuple[IO[bytes], ...]] = deque()
        """Files to force and close, before those of the next request."""
        self._thread: threading.Thread | None = None
        self._error: OSError | None = None

    def request(self, *descriptors: int) -> None:
        """Force open files onto the disk, in this order; returns at once. They stay open until `wait` returns.

        Requests during an earlier one become one.
        """
        with self._lock:
            self._descriptors = descriptors
            self._start()

    def force_and_close(self, *files: IO[bytes]) -> None:
        """Force flushed files onto the disk, in this order, and close them; returns at once.

        The next request is theirs: it is dropped.
        """
        with self._lock:
            self._descriptors = ()
            self._finished.append(files)
            self._start()

    def _start(self) -> None:
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="skincal-disk", daemon=True)
            self._thread.start()

    def wait(self) -> None:
        """Wait for all requests."""
        # Read once: the thread clears it at its end.
        thread = self._thread
        if thread is not None:
            thread.join()

    def raise_error(self) -> None:
        """Raise the first OSError of a request."""
        if self._error is not None:
            raise self._error

    def _run(self) -> None:
        while True:
            with self._lock:
                finished = self._finished.popleft() if self._finished else ()
                descriptors = tuple(file.fileno() for file in finished)
                if not finished:
                    descriptors, self._descriptors = self._descriptors, ()
                if not descriptors or (self._error is not None and not finished):
                    self._thread = None
                    return
            try:
                for descriptor in descriptors:
                    os.fsync(descriptor)
            except OSError as error:
                self._error = self._error or error
            for file in finished:
                with contextlib.suppress(OSError):
                    file.close()
