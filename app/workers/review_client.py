"""Has landmark pokes reviewed beside the window: what they say of the rig takes some tenths of a second to work out.

A process is asked from the first poke at a landmark on, and sent what is new of the session since it was asked last. There is
one review at a time, and its work gives way to a newer request.
"""

from __future__ import annotations

import logging
import uuid
from dataclasses import replace
from functools import partial

from PySide6.QtCore import QObject, Signal

from app.workers.processes import ProcessLostError, ProcessService
from app.workers.threads import ThreadService
from skincal.model.errors import InputError
from skincal.session.review import Asked, Change, Review, ReviewedPart, Unreviewed, review_change
from skincal.session.session import Session
from skincal.session.snapshot import PokeRecord, Snapshot

LOG = logging.getLogger(__name__)
SKIN = 10
"""Pokes on the skin after which the rig is reviewed anew: a single poke moves what is found by less than is shown."""

OF_RIG = ("at_landmarks", "landmarks", "corrections", "dead")
"""Fields of a snapshot that a review depends on, beside the pokes."""


class ReviewClient(QObject):
    """Asks for the reviews of a session.

    Parameters
    ----------
    processes : where the work is done
    """

    reviewed = Signal(object)
    """`Review` of what was asked last, or of what was asked before where that was finished all the same."""
    failed = Signal(str)
    """A sentence; nothing is reviewed any more."""

    def __init__(self, session: Session, processes: ProcessService, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._session = session
        self._processes = processes
        self._threads = ThreadService("review", self)
        self._name = uuid.uuid4().hex
        self._asked = Asked()
        self._seen: Snapshot | None = None
        self._shown: Snapshot | None = None
        """The snapshot whose review was asked for last; None before the first poke at a landmark."""
        self._waits = self._again = False
        self._stopped = False

    def follow(self, snapshot: Snapshot) -> None:
        """Ask for a review of the session where its newest snapshot has enough that is new since the last."""
        seen, self._seen = self._seen, snapshot
        if self._stopped or not (self._shown or snapshot.at_landmarks) or (seen is not None and _same(seen, snapshot)):
            return
        if self._shown is None or _due(self._shown, snapshot):
            self._ask(snapshot)

    def stop(self) -> None:
        """Ask no more, and hear no answer; what the process works on is given up. Returns at once."""
        self._stopped = True
        self._processes.ticket()
        self._threads.close(0.0)

    def _ask(self, snapshot: Snapshot) -> None:
        self._shown = snapshot
        ticket = self._processes.ticket()
        self._again = self._waits
        if self._again:
            return  # what is worked on gives way; then the newest is asked about
        self._waits = True
        change = self._asked.change(self._session, snapshot)
        surface, part = self._session.surface, None
        if not change.since:
            part = ReviewedPart(self._session.scene, None if surface is None else surface.sha256)
        self._threads.submit(partial(_review, self._processes, ticket, self._name, part, change), self._take, self._fail)

    def _take(self, answer: Review | Unreviewed) -> None:
        self._waits = False
        if answer is Unreviewed.UNKNOWN:
            self._asked.forget()
            self._again = True
        elif isinstance(answer, Review):
            self.reviewed.emit(replace(answer, used=self._asked.used))
        if self._again and self._seen is not None and not self._stopped:
            self._ask(self._seen)

    def _fail(self, sentence: str) -> None:
        self._stopped = True
        self.failed.emit(sentence)


def _review(
    processes: ProcessService, ticket: int, session: str, part: ReviewedPart | None, change: Change
) -> Review | Unreviewed:
    """Have a change reviewed in the process; in a thread.

    Raises
    ------
    InputError
        There will be no reviews, whatever the reason is.
    """
    try:
        return processes.ask(ticket, review_change, session, part, change)
    except InputError:
        raise
    except ProcessLostError as lost:
        raise InputError(f"The rig is not reviewed any more: {lost}, twice. Open the session again.") from lost
    except Exception as error:
        LOG.exception("a review of the rig failed")
        raise InputError(f"The rig is not reviewed any more: {error!r}; details are in the log.") from error


def _same(first: Snapshot, second: Snapshot) -> bool:
    """Return whether two snapshots agree in all that is reviewed; most do, since streamed joints make one a frame."""
    return first is second or all(getattr(first, name) == getattr(second, name) for name in ("pokes", *OF_RIG))


def _due(asked: Snapshot, now: Snapshot) -> bool:
    """Return whether a session is to be reviewed anew: at once where landmark pokes, corrections or taken out pokes changed."""
    if any(getattr(asked, name) != getattr(now, name) for name in OF_RIG) or len(now.pokes) >= len(asked.pokes) + SKIN:
        return True
    return any(_changed(before, after, now) for before, after in zip(asked.pokes, now.pokes, strict=False))


def _changed(before: PokeRecord, now: PokeRecord, snapshot: Snapshot) -> bool:
    """Return whether a poke counts that did not, or no more, or is a landmark poke whose outcome came again."""
    came_again = before.outcome is not now.outcome and now.outcome.poke in snapshot.at_landmarks
    return before.excluded != now.excluded or came_again
