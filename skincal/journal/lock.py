"""One writer a session's folder: a lock that the operating system takes back when the process dies.

The lock lies on the file `session.lock`, which also names its holder for other programs' messages. A file without a lock on it
means nothing: its writer was killed. Readers look at the lock without creating or changing anything.
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
_PATIENCE_S = 0.3
"""s. A reader that looks holds a shared lock for some microseconds; a writer tries again for so long."""
_RETRY_S = 0.02
_LOCK_HELD_ERRNOS = (errno.EACCES, errno.EAGAIN, errno.EDEADLK)
_TEXT_BYTES = 400

if sys.platform == "win32":
    import msvcrt

    _PLACE = 1 << 30
    """Byte that is locked: Windows lets nobody read a locked byte, and the text must be read."""

    def _take(file: FileIO, *, shared: bool) -> None:  # noqa: ARG001 - Windows knows no shared lock here
        file.seek(_PLACE)
        msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)

else:
    import fcntl

    def _take(file: FileIO, *, shared: bool) -> None:
        fcntl.flock(file.fileno(), (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)


class RecordedElsewhereError(InputError):
    """Another process writes into the session's folder."""


class SessionLock:
    """The right to write into a session's folder, held until `release` or the end of the process.

    Raises
    ------
    RecordedElsewhereError
        Another process, or another part of this one, writes there.
    InputError
        The folder cannot be written or locked.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / LOCK_NAME
        end = time.monotonic() + _PATIENCE_S
        try:
            while (file := _locked(self._path)) is None and time.monotonic() < end:
                time.sleep(_RETRY_S)
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
        """Let others write; more calls do nothing."""
        if self._file.closed:
            return
        with contextlib.suppress(OSError):
            # Before the lock goes: else it could be the next writer's file that is taken away.
            if sys.platform == "win32":  # where an open file stays
                self._file.close()
            self._path.unlink()
        self._file.close()


def writer_of(folder: Path) -> str:
    """Name the program that writes into a session's folder; empty if there is none. Changes nothing."""
    path = folder / LOCK_NAME
    try:
        file = FileIO(path, "r", opener=_open_plain)
    except OSError:
        return ""
    with file:
        try:
            _take(file, shared=True)
        except OSError as error:
            return _words_of(path) if error.errno in _LOCK_HELD_ERRNOS else ""
    return ""


def _locked(path: Path) -> FileIO | None:
    """Return the file with the lock on it; None where another holds it."""
    # Not "w": until the lock is had, the file must go on naming its holder.
    file = FileIO(path, "a+", opener=_open_plain)
    try:
        _take(file, shared=False)
        if os.fstat(file.fileno()).st_nlink > 1:
            # What is written here would be written elsewhere, too, and a copy by links would be locked with it.
            raise OSError(errno.EMLINK, f"{LOCK_NAME} has another name elsewhere: take this one away")
        # The one who held it may have taken the file away since it was opened here.
        if path.exists() and os.path.samestat(os.fstat(file.fileno()), path.stat()):
            return file
    except OSError as error:
        if error.errno not in (*_LOCK_HELD_ERRNOS, errno.ENOENT):
            file.close()
            raise
    file.close()
    return None


def _open_plain(path: str, flags: int) -> int:
    """Open a regular file, not what a link of its name leads to, nor a pipe: a stranger may have made it.

    Else it would choose what is written over, or keep who reads it waiting for ever.
    """
    if Path(path).is_symlink():
        raise OSError(errno.ELOOP, f"{LOCK_NAME} is a link")
    file = os.open(path, flags | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0), 0o666)
    if not stat.S_ISREG(os.fstat(file).st_mode):
        os.close(file)
        raise OSError(errno.EINVAL, f"{LOCK_NAME} is no file")
    return file


def _words_of(path: Path) -> str:
    """Read the holder of a lock from its file."""
    try:
        with FileIO(path, "r", opener=_open_plain) as file:
            process, host, begun, *_ = (file.read(_TEXT_BYTES) or b"").decode().split("\n")
    except (OSError, ValueError):
        return "another process"
    return f"process {process} on {host} since {begun}"
