"""Lets another process tell what landmark pokes say of the rig, and never waits for it.

It is started with the first poke at a landmark, and told what is new of the session; only its answer to the newest is
passed on.
"""

from __future__ import annotations

import sys
from dataclasses import replace

from PySide6.QtCore import QObject, QProcess, Signal

from app.child import child_environment
from skincal.session.review import Asked, Review
from skincal.session.review_process import Part, Unpacker, packed
from skincal.session.session import Session
from skincal.session.snapshot import PokeRecord, Snapshot

MODULE = "skincal.session.review_process"
STOP_MS = 700
"""The process gets this long to end by itself after its input closed, before it is killed."""
SKIN = 10
"""Pokes on the skin after which the rig is reviewed anew: one alone moves what is found by less than is shown."""
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
        self._started = False
        self._seen: Snapshot | None = None
        self._shown: Snapshot | None = None
        """The one that was reviewed last."""
        self._process = QProcess(self)
        self._process.readyReadStandardOutput.connect(self._read)
        self._process.finished.connect(self._finished)
        self._process.errorOccurred.connect(self._error)
        self._process.setProcessEnvironment(child_environment())

    def follow(self, snapshot: Snapshot) -> None:
        """Ask for a review of the session where its newest snapshot tells enough that the one reviewed last did not."""
        seen, self._seen = self._seen, snapshot
        if self._stopping or not (self._started or snapshot.at_landmarks) or (seen is not None and _same(seen, snapshot)):
            return
        if not self._started:
            self._start()
        elif self._shown is not None and not _due(self._shown, snapshot):
            return
        self._shown = snapshot
        self._tell(self._asked.change(self._session, snapshot))

    def _start(self) -> None:
        self._started = True
        self._process.start(sys.executable, ["-P", "-m", MODULE])
        surface = self._session.surface
        self._tell(Part(self._session.scene, None if surface is None else surface.sha256))

    @property
    def _running(self) -> bool:
        return self._process.state() is not QProcess.ProcessState.NotRunning

    def _tell(self, message: object) -> None:
        if self._running:
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
                    self.reviewed.emit(replace(message, used=self._asked.used))
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


OF_RIG = ("at_landmarks", "landmarks", "corrections", "dead")


def _same(first: Snapshot, second: Snapshot) -> bool:
    """Return whether two snapshots tell the same of what is reviewed; most do, since streamed joints make one a frame."""
    return first is second or all(getattr(first, name) == getattr(second, name) for name in ("pokes", *OF_RIG))


def _due(asked: Snapshot, now: Snapshot) -> bool:
    """Return whether a session is to be reviewed anew: at once where landmark pokes, corrections or taken out pokes changed."""
    if any(getattr(asked, name) != getattr(now, name) for name in OF_RIG) or len(now.pokes) >= len(asked.pokes) + SKIN:
        return True
    return any(_changed(one, other, now) for one, other in zip(asked.pokes, now.pokes, strict=False))


def _changed(before: PokeRecord, now: PokeRecord, snapshot: Snapshot) -> bool:
    """Return whether a poke counts that did not, or no more, or is a landmark poke that was told again."""
    told_again = before.outcome is not now.outcome and now.outcome.poke in snapshot.at_landmarks
    return before.excluded != now.excluded or told_again
