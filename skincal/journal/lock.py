"""One writer per session folder: a lock that the operating system releases when the process dies.

The lock is on the file `session.lock`, which also names its holder for messages of other programs. The file alone means
nothing: its writer may have been killed. Readers check the lock without creating or changing anything.
"""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import stat
import sys
import time
from datetime import datetime
from io import FileIO
from pathlib import Path

from skincal.model.errors import InputError

LOCK_NAME = "session.lock"
RETRY_FOR_S, RETRY_EVERY_S = 0.3, 0.02
"""s. A reader that checks holds a shared lock for some microseconds; a writer tries again."""
_LOCK_HELD_ERRNOS = (errno.EACCES, errno.EAGAIN, errno.EDEADLK)
LOCK_HOLDER_TEXT_MAX_BYTES = 400

if sys.platform == "win32":
    import msvcrt

    LOCKED_BYTE = 1 << 30
    """Behind the text: Windows lets no program read a locked byte."""

    def _acquire(file: FileIO, *, shared: bool) -> None:  # noqa: ARG001 - Windows knows no shared lock here
        file.seek(LOCKED_BYTE)
        msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)

else:
    import fcntl

    def _acquire(file: FileIO, *, shared: bool) -> None:
        fcntl.flock(file.fileno(), (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)


class RecordedElsewhereError(InputError):
    """Another process writes to the session's folder."""


class SessionLock:
    """The right to write to a session's folder, until `release` or the end of the process.

    Raises
    ------
    RecordedElsewhereError
        Another process, or another part of this one, writes there.
    InputError
        The folder cannot be written or locked.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / LOCK_NAME
        end = time.monotonic() + RETRY_FOR_S
        try:
            while (file := _locked(self._path)) is None and time.monotonic() < end:
                time.sleep(RETRY_EVERY_S)
            if file is not None:
                file.truncate(0)
                file.write(f"{os.getpid()}\n{socket.gethostname()}\n{datetime.now().astimezone():%Y-%m-%d %H:%M:%S}\n".encode())
        except OSError as error:
            raise InputError(
                f"{folder}: cannot be locked for writing ({error.strerror}); check the folder's rights, "
                "or copy the session to a local disk."
            ) from None
        if file is None:
            raise RecordedElsewhereError(
                f"{folder}: is being recorded by {_words_of(self._path)}; end that recording first. "
                "`skincal solve` and `skincal export` read it meanwhile."
            )
        self._file = file

    def release(self) -> None:
        """Release the lock; further calls do nothing."""
        if self._file.closed:
            return
        with contextlib.suppress(OSError):
            # Before the lock is released: later it could be the next writer's file.
            if sys.platform == "win32":  # where an open file stays
                self._file.close()
            self._path.unlink()
        self._file.close()


def describe_lock_holder(folder: Path) -> str:
    """Describe the program that writes to a session's folder; empty if there is none. Changes nothing."""
    path = folder / LOCK_NAME
    try:
        file = FileIO(path, "r", opener=_open_plain)
    except OSError:
        return ""
    with file:
        try:
            _acquire(file, shared=True)
        except OSError as error:
            return _words_of(path) if error.errno in _LOCK_HELD_ERRNOS else ""
    return ""


def _locked(path: Path) -> FileIO | None:
    """Open the file and lock it; `None` if another holds the lock."""
    # Not "w": the file names the holder until the lock changes hands.
    file = FileIO(path, "a+", opener=_open_plain)
    try:
        _acquire(file, shared=False)
        if os.fstat(file.fileno()).st_nlink > 1:
            # Its other name would be written to, and locked, too.
            raise OSError(errno.EMLINK, f"{LOCK_NAME} has another name elsewhere: take this one away")
        # The last holder may have removed the file since it was opened here.
        if path.exists() and os.path.samestat(os.fstat(file.fileno()), path.stat()):
            return file
    except OSError as error:
        if error.errno not in (*_LOCK_HELD_ERRNOS, errno.ENOENT):
            file.close()
            raise
    file.close()
    return None


def _open_plain(path: str, flags: int) -> int:
    """Open a regular file only. A stranger's link could have another file overwritten, and a pipe would never answer."""
    if Path(path).is_symlink():
        raise OSError(errno.ELOOP, f"{LOCK_NAME} is a link")
    file = os.open(path, flags | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0), 0o666)
    if not stat.S_ISREG(os.fstat(file).st_mode):
        os.close(file)
        raise OSError(errno.EINVAL, f"{LOCK_NAME} is no file")
    return file


def _words_of(path: Path) -> str:
    """Describe the holder of a lock, from its file."""
    try:
        with FileIO(path, "r", opener=_open_plain) as file:
            process, host, begun, *_ = (file.read(LOCK_HOLDER_TEXT_MAX_BYTES) or b"").decode().split("\n")
    except (OSError, ValueError):
        return "another process"
    return f"process {process} on {host} since {begun}"
