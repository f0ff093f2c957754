"""Lets another process tell what landmark pokes say of the rig, and never waits for it.

It is started when there are landmarks, and told what is new of the session; only its answer to the newest is passed on.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from PySide6.QtCore import QObject, QProcess, QProcessEnvironment, Signal

import skincal
from skincal.session.review import Asked, Review
from skincal.session.review_process import Part, Unpacker, packed
from skincal.session.session import Session

MODULE = "skincal.session.review_process"
STOP_MS = 700
"""The process gets this long to end by itself after its input closed, before it is killed."""
TAIL = 400
"""Characters of its error output that are shown where it ends too early."""


class ReviewServer(QObject):
    """One process for one session."""

    reviewed = Signal(object)
    """`Review` of the newest that was asked."""
    failed = Signal(str)
    """A sentence; nothing is reviewed any more."""

    def __init__(self, session: Session, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._session = session
        self._asked = Asked()
        self._unpacker = Unpacker()
        self._stopping = False
        self._process = QProcess(self)
        self._process.readyReadStandardOutput.connect(self._read)
        self._process.finished.connect(self._finished)
        self._process.errorOccurred.connect(self._error)
        environment = QProcessEnvironment.systemEnvironment()
        # The window may have been started from another folder than the package's.
        paths = [str(Path(skincal.__file__).resolve().parent.parent), environment.value("PYTHONPATH")]
        environment.insert("PYTHONPATH", os.pathsep.join(filter(None, paths)))
        self._process.setProcessEnvironment(environment)

    def start(self) -> None:
        """Start the process; returns at once."""
        self._process.start(sys.executable, ["-m", MODULE])
        surface = self._session.surface
        self._tell(Part(self._session.scene, None if surface is None else surface.sha256))

    def ask(self) -> None:
        """Ask for a review of the session as it stands."""
        if self._running and not self._stopping:
            self._tell(self._asked.change(self._session))

    @property
    def _running(self) -> bool:
        return self._process.state() is not QProcess.ProcessState.NotRunning

    def _tell(self, message: object) -> None:
        self._process.write(packed(message))

    def release(self) -> None:
        """Ask the process to end, without waiting; this object goes when it has."""
        self._stopping = True
        self._process.finished.connect(self.deleteLater)
        if self._running:
            self._process.closeWriteChannel()
            self._process.kill()
        else:
            self.deleteLater()

    def stop(self) -> None:
        """End the process: by closing its input, then by force. It keeps nothing that could be lost."""
        self._stopping = True
        if not self._running:
            return
        self._process.closeWriteChannel()
        if not self._process.waitForFinished(STOP_MS):
            self._process.kill()
            self._process.waitForFinished(STOP_MS)

    def _read(self) -> None:
        for message in self._unpacker.feed(bytes(self._process.readAllStandardOutput().data())):
            if self._stopping:
                return
            if isinstance(message, Review):
                if message.generation == self._asked.generation:
                    self.reviewed.emit(message)
            else:
                self._fail(str(message))

    def _fail(self, sentence: str) -> None:
        self._stopping = True
        self.failed.emit(sentence)

    def _finished(self) -> None:
        if not self._stopping:
            said = bytes(self._process.readAllStandardError().data()).decode(errors="replace").strip()[-TAIL:]
            self._fail(f"What reviews the rig ended (code {self._process.exitCode()}). {said}".strip())

    def _error(self, error: QProcess.ProcessError) -> None:
        if error is QProcess.ProcessError.FailedToStart and not self._stopping:
            self._fail(f"What reviews the rig cannot be started: {self._process.errorString()}.")
