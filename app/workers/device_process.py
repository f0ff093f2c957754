"""The process of the simulated devices; nothing here blocks the window.

It prints one line of JSON with its links and, if it simulates a rig, its taxels. It runs until its standard input closes. Its
operator gets poke targets as a robot does (`skincal/robot/target_server.py`).
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path

from PySide6.QtCore import QObject, QProcess, QProcessEnvironment, Signal

import skincal

PROCESS_STOP_TIMEOUT_MS = 700
"""Time for the process to end after its input closed, before it is terminated, then killed."""
SHOWN_ERROR_MAX_CHARS = 400  # Characters of its error output that are shown
INPUT_ERROR_EXIT_CODE = 2  # Exit code of a command with wrong input, which prints one sentence
SENTENCE_PREFIX = "skincal: "


class DeviceProcess(QObject):
    """Process that simulates devices for a demonstration."""

    served = Signal(object)  # tuple of `LinkSpec`
    truth_printed = Signal(object)  # bytes for a `truth.json`, before `served`: the taxels of a simulated rig
    failed = Signal(str)  # It did not start, printed no links, or ended without `stop`

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._process = QProcess(self)
        self._line = b""
        self._stopping = False
        self._process.finished.connect(self._on_finished)
        self._process.errorOccurred.connect(self._on_error)

    def start(self, command: Sequence[str]) -> None:
        """Start the process; returns at once."""
        environment = QProcessEnvironment.systemEnvironment()
        # It imports the same package as this process.
        paths = [str(Path(skincal.__file__).resolve().parent.parent), environment.value("PYTHONPATH")]
        environment.insert("PYTHONPATH", os.pathsep.join(filter(None, paths)))
        self._process.setProcessEnvironment(environment)
        self._process.start(command[0], list(command[1:]))

    def listen(self) -> None:
        """Report the links that the process prints or has printed. Imports the module of links."""
        self._process.readyReadStandardOutput.connect(self._read)
        if self._process.bytesAvailable():
            self._read()

    @property
    def is_running(self) -> bool:
        """Whether the process runs or starts."""
        return self._process.state() is not QProcess.ProcessState.NotRunning

    def send_line(self, line: str) -> None:
        """Write a line to its input, unless it has ended; returns at once."""
        if self.is_running and not self._stopping:
            self._process.write(f"{line}\n".encode())

    def release(self) -> None:
        """Ask the process to end and delete this object afterwards; returns at once."""
        self._stopping = True
        self._process.finished.connect(self.deleteLater)
        if self.is_running:
            self._process.closeWriteChannel()
        else:
            self.deleteLater()

    def stop(self) -> None:
        """End the process and wait for it."""
        self._stopping = True
        for end in (self._process.closeWriteChannel, self._process.terminate, self._process.kill):
            if not self.is_running:
                return
            end()
            self._process.waitForFinished(PROCESS_STOP_TIMEOUT_MS)

    def _read(self) -> None:
        if self._stopping:
            return
        self._line += bytes(self._process.readAllStandardOutput().data())
        head, newline, _ = self._line.partition(b"\n")
        if not newline:
            return
        self._line = b""
        self._process.readyReadStandardOutput.disconnect(self._read)
        try:
            links = parse_links(head)
        except (ValueError, KeyError, TypeError) as error:
            self.failed.emit(f"The device process printed {head[:80]!r}; expected its links as JSON ({error}).")
            return
        if b'"taxels"' in head:
            self.truth_printed.emit(head)
        self.served.emit(links)

    def _on_finished(self) -> None:
        if not self._stopping:
            printed = bytes(self._process.readAllStandardError().data()).decode(errors="replace").strip()
            was_killed = self._process.exitStatus() is QProcess.ExitStatus.CrashExit
            self.failed.emit(end_words(None if was_killed else self._process.exitCode(), printed))

    def _on_error(self, error: QProcess.ProcessError) -> None:
        # A process that fails to start emits no `finished`.
        if error is QProcess.ProcessError.FailedToStart and not self._stopping:
            self.failed.emit(f"The device process cannot be started: {self._process.errorString()}.")


def end_words(code: int | None, printed: str) -> str:
    """Describe the end of a process: `code` is `None` if it was killed, `printed` its error output."""
    last = printed.rpartition("\n")[2]
    if code == INPUT_ERROR_EXIT_CODE and last.startswith(SENTENCE_PREFIX):
        return last.removeprefix(SENTENCE_PREFIX)
    how = "was killed" if code is None else f"ended (code {code})"
    return f"The device process {how}. {printed[-SHOWN_ERROR_MAX_CHARS:]}".strip()


def parse_links(line: bytes) -> tuple[object, ...]:
    """Parse the printed links into `LinkSpec`.

    Raises
    ------
    ValueError, KeyError, TypeError
        The line is not what a serving process prints.
    """
    from skincal.model.readings import Stream
    from skincal.streams.links import LinkSpec

    entries = json.loads(line)["links"]
    return tuple(LinkSpec(e["name"], e["address"], tuple(Stream(s) for s in e["carries"])) for e in entries)
