"""The process that simulates devices: kept, read and told its pace, without ever blocking the window.

It prints one line of JSON that names its links, and, where it simulates them, its taxels; it runs until its standard input
closes. What its operator pokes it is asked as a robot is (`skincal/robot/target_server.py`).
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path

from PySide6.QtCore import QObject, QProcess, QProcessEnvironment, Signal

import skincal

STOP_MS = 700
"""The process gets this long to end by itself after its input closed, before it is terminated."""
TAIL = 400
"""Characters of its error output that are shown where it ends too early."""
INPUT_AT_FAULT = 2
"""Exit code of a command whose input is at fault, and which says in one sentence how."""
SPEAKER = "skincal: "
"""What such a sentence begins with."""


class DeviceProcess(QObject):
    """One process; `served` once it said its links, `failed` where it did not or ended by itself."""

    served = Signal(object)
    """tuple of `LinkSpec`."""
    said_truth = Signal(object)
    """bytes that serve as a `truth.json`, before `served`: a simulated rig knows where its taxels are."""
    failed = Signal(str)

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._process = QProcess(self)
        self._line = b""
        self._stopping = False
        self._process.readyReadStandardOutput.connect(self._read)
        self._process.finished.connect(self._finished)
        self._process.errorOccurred.connect(self._error)

    def start(self, command: Sequence[str]) -> None:
        """Start the process; returns at once."""
        environment = QProcessEnvironment.systemEnvironment()
        # The process finds the package where this one did.
        paths = [str(Path(skincal.__file__).resolve().parent.parent), environment.value("PYTHONPATH")]
        environment.insert("PYTHONPATH", os.pathsep.join(filter(None, paths)))
        self._process.setProcessEnvironment(environment)
        self._process.start(command[0], list(command[1:]))

    @property
    def running(self) -> bool:
        """Whether the process runs or starts."""
        return self._process.state() is not QProcess.ProcessState.NotRunning

    def tell(self, line: str) -> None:
        """Write a line to the process, without waiting for it to be read; nothing where it has ended."""
        if self.running and not self._stopping:
            self._process.write(f"{line}\n".encode())

    def release(self) -> None:
        """Ask the process to end, without waiting; this object goes when it has."""
        self._stopping = True
        self._process.finished.connect(self.deleteLater)
        if self.running:
            self._process.closeWriteChannel()
        else:
            self.deleteLater()

    def stop(self) -> None:
        """End the process: by closing its input, then by asking, then by force."""
        self._stopping = True
        if not self.running:
            return
        self._process.closeWriteChannel()
        if self._process.waitForFinished(STOP_MS):
            return
        self._process.terminate()
        if not self._process.waitForFinished(STOP_MS):
            self._process.kill()
            self._process.waitForFinished(STOP_MS)

    def _read(self) -> None:
        if self._stopping:
            return  # What it says now is of a session that is closed.
        self._line += bytes(self._process.readAllStandardOutput().data())
        head, newline, _ = self._line.partition(b"\n")
        if not newline:
            return
        self._line = b""
        self._process.readyReadStandardOutput.disconnect(self._read)
        try:
            links = parse_links(head)
        except (ValueError, KeyError, TypeError) as error:
            self.failed.emit(f"The device process said {head[:80]!r}; expected its links as JSON ({error}).")
            return
        if b'"taxels"' in head:
            self.said_truth.emit(head)
        self.served.emit(links)

    def _finished(self) -> None:
        if not self._stopping:
            said = bytes(self._process.readAllStandardError().data()).decode(errors="replace").strip()
            killed = self._process.exitStatus() is QProcess.ExitStatus.CrashExit
            self.failed.emit(end_words(None if killed else self._process.exitCode(), said))

    def _error(self, error: QProcess.ProcessError) -> None:
        # A process that does not start is never said to have finished.
        if error is QProcess.ProcessError.FailedToStart and not self._stopping:
            self.failed.emit(f"The device process cannot be started: {self._process.errorString()}.")


def end_words(code: int | None, said: str) -> str:
    """Return what is said of a process that ended by itself.

    Parameters
    ----------
    code : it ended with; None where it was killed
    said : its error output
    """
    last = said.rpartition("\n")[2]
    if code == INPUT_AT_FAULT and last.startswith(SPEAKER):
        return last.removeprefix(SPEAKER)
    how = "was killed" if code is None else f"ended (code {code})"
    return f"The device process {how}. {said[-TAIL:]}".strip()


def parse_links(line: bytes) -> tuple[object, ...]:
    """Return the links that a process named, as `LinkSpec`.

    Raises
    ------
    ValueError, KeyError, TypeError
        The line is not what a serving process prints.
    """
    from skincal.model.readings import Stream
    from skincal.streams.links import LinkSpec

    entries = json.loads(line)["links"]
    return tuple(LinkSpec(e["name"], e["address"], tuple(Stream(s) for s in e["carries"])) for e in entries)
